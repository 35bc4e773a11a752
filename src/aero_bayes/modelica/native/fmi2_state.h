/* The state of an FMU: kept, set, and as bytes. Included by fmi2.c. */
#define KEY 40 /* bytes of the model's guid before a serialized state */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
    Instance *s = c;
    if (!*state) *state = malloc(MODEL_SIZE);
    if (!*state) return fail(s, fmi2Error, "fmi2GetFMUstate: out of memory");
    memcpy(*state, s->m, MODEL_SIZE);
    begin_steps(s->steps);
    return fmi2OK;
}
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
    Instance *s = c;
    if (!state) return fail(s, fmi2Error, "fmi2SetFMUstate: no state");
    memcpy(s->m, state, MODEL_SIZE);
    begin_steps(s->steps);
    return fmi2OK;
}
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
    (void)c;
    if (state) { free(*state); *state = NULL; }
    return fmi2OK;
}
fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size) {
    (void)c; (void)state;
    *size = KEY + MODEL_SIZE;
    return fmi2OK;
}
fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
    if (!state || size < KEY + MODEL_SIZE) return fail(c, fmi2Error, "fmi2SerializeFMUstate: the buffer is too small");
    memset(bytes, 0, KEY);
    strncpy(bytes, INFO.guid, KEY);
    memcpy(bytes + KEY, state, MODEL_SIZE);
    return fmi2OK;
}
fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
    Instance *s = c;
    if (size != KEY + MODEL_SIZE || strncmp(bytes, INFO.guid, KEY))
        return fail(s, fmi2Error, "fmi2DeSerializeFMUstate: not a state of this model");
    if (!*state) *state = malloc(MODEL_SIZE);
    if (!*state) return fail(s, fmi2Error, "fmi2DeSerializeFMUstate: out of memory");
    memcpy(*state, bytes + KEY, MODEL_SIZE);
    return fmi2OK;
}
