/* FMI 2.0 Co-Simulation. Included by fmi2.c. */
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real start, fmi2Real size, fmi2Boolean no_set_state) {
    Instance *s = c;
    Model *m = s->m;
    (void)no_set_state;
    if (!(m->phase & (EVENT | STEPPED))) return fail(s, fmi2Error, "fmi2DoStep: the model is not initialised");
    if (!(size > 0)) return fail(s, fmi2Error, "fmi2DoStep: step size %g", size);
    m->phase = STEPPED;
    const int nz = count_indicators();
    double end = start + size, t = start, x[NXX], y[NXX], z[nz + 1], now_z[nz + 1];
    memset(y, 0, sizeof y);
    m->time = start;
    invalidate(m, DEPENDS_ON_STATE);
    int status = handle_event(m); /* inputs may have jumped */
    memcpy(x, group(m, R), NX * sizeof *x);
    double h = m->step > 0 ? m->step : size * 1e-3, since = start;
    int events = 0;
    if (!s->steps) s->steps = open_steps(m);
    if (s->steps && status >= 0 && m->next_event > end + 1e-12 * fmax(1, fabs(end))) {
        t = exponential_until(s->steps, t, x, end);
        move_to(m, t, x);
    }
    if (nz) event_indicators(m, z);
    for (long count = 0; (NX > 0 || nz || isfinite(m->next_event)) && t < end && status >= 0; count++) {
        /* an event due at the end belongs to this step: its values are those after it */
        double due = m->next_event, stop = fmin(end, due), left = stop - t;
        int last = h >= left * (1 - 1e-12) || NX == 0;
        double now = last ? left : h > 0.5 * left ? 0.5 * left : h;
        double e = NX ? rodas(m, t, x, now, y) : 0;
        double grow = e < 0 ? 0.1 : fmin(5, fmax(0.2, 0.9 * pow(fmax(e, 1e-10), -0.25)));
        if (e >= 0 && e <= 1) {
            int at_event = last && due <= end + 1e-12 * fmax(1, fabs(end)), found = 0;
            double taken = now;
            if (nz) {
                move_to(m, t + now, y);
                event_indicators(m, now_z);
                found = crossed(z, now_z, nz);
                if (found) taken = locate_event(m, t, x, now, y, z, nz);
            }
            t = found ? t + taken : last ? stop : t + now;
            memcpy(x, y, NX * sizeof *x);
            h = last && now * grow < h ? h : now * grow;
            if (found || at_event) {
                if (t - since > 1e-9 * fmax(1, fabs(t))) { since = t; events = 0; }
                if (++events > 10000) {
                    m->phase = FAILED;
                    return fail(s, fmi2Error, "fmi2DoStep: events without end at t = %g", t);
                }
                move_to(m, t, x);
                status = handle_event(m);
                memcpy(x, group(m, R), NX * sizeof *x);
            }
            if (nz) { move_to(m, t, x); event_indicators(m, z); }
        } else {
            h = now * fmin(grow, 0.9);
            if (!(h > 1e-14 * fmax(fabs(t), size)) || count > 10000000) {
                move_to(m, t, x);
                m->phase = FAILED;
                return fail(s, fmi2Error, "fmi2DoStep: the solver cannot pass t = %g", t);
            }
        }
    }
    m->step = h;
    move_to(m, status < 0 ? t : end, x);
    if (status < 0) {
        m->phase = FAILED;
        return fail(s, fmi2Error, "fmi2DoStep: the event at t = %g does not come to an end", t);
    }
    check_assertions(s);
    m->failed = 0;
    return fmi2OK;
}

fmi2Status fmi2CancelStep(fmi2Component c) { return fail(c, fmi2Error, "fmi2CancelStep: steps are synchronous"); }
fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[], const fmi2Real value[]) {
    (void)vr; (void)order; (void)value;
    return n ? fail(c, fmi2Error, "fmi2SetRealInputDerivatives: inputs are held over a step") : fmi2OK;
}
fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[], fmi2Real value[]) {
    (void)vr; (void)order; (void)value;
    return n ? fail(c, fmi2Error, "fmi2GetRealOutputDerivatives: not provided") : fmi2OK;
}
fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value) { (void)kind; (void)value; return fail(c, fmi2Discard, "fmi2GetStatus: steps are synchronous"); }
fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    if (kind == fmi2LastSuccessfulTime) { *value = ((Instance *)c)->m->time; return fmi2OK; }
    return fail(c, fmi2Discard, "fmi2GetRealStatus: not provided");
}
fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value) { (void)kind; (void)value; return fail(c, fmi2Discard, "fmi2GetIntegerStatus: not provided"); }
fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    if (kind == fmi2Terminated) { *value = fmi2False; return fmi2OK; }
    return fail(c, fmi2Discard, "fmi2GetBooleanStatus: not provided");
}
fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value) { (void)kind; (void)value; return fail(c, fmi2Discard, "fmi2GetStringStatus: not provided"); }
