"""How much of an effect a recording holds: the information distance of the blind trial.

The recording without its noise is fitted by the model that lacks the effect, all its parameters free; what remains, in
units of the true noise (its correlation counted), is the part of the effect's signature that no change of the others
can imitate. From its square is taken what the model that has the effect leaves (a smoothed step is not a step).
Readings of an encoder that stands still count as little as they do for the loop.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from aero_bayes.data import Recording
from aero_bayes.estimate import calibrate, declared_overrides, parameters_from_model
from aero_bayes.estimate.global_search import GlobalSearch
from aero_bayes.estimate.local_fit import LocalFitSettings, local_fit
from aero_bayes.estimate.objective import Objective
from aero_bayes.laws.modelica_family import ModelicaFamily
from aero_bayes.loop import LoopSettings
from aero_bayes.sensors.noise import OutputNoise
from aero_bayes.simulation import open_simulator
from aero_bayes.simulation.interface import Problem, Simulator, SolverSettings
from aero_trial.draw import TrialSpec
from simulated_aero.truth import EffectTruth

OUTPUTS = ("i_m", "omega_m", "theta")


def true_noise(spec: TrialSpec) -> dict[str, OutputNoise]:
    """Return the noise of each output; an encoder's counts add the variance of their width, ripple is left out."""
    noise = {}
    for output in OUTPUTS:
        item = getattr(spec.sensors, output)
        white = item.white
        if output == "theta" and spec.sensors.encoder_counts:
            white = float(np.hypot(white, 2.0 * np.pi / spec.sensors.encoder_counts / np.sqrt(12.0)))
        noise[output] = OutputNoise(white, item.slow, item.slow_time) if item.slow > 0.0 else OutputNoise(white)
    return noise


def effect_distances(spec: TrialSpec, noise_free: Recording, family: ModelicaFamily, ids: Sequence[str]) -> list[float]:
    """Compute the distance of each effect; the model knows the others of the truth (catalogue effects only)."""
    if not ids:
        return []
    listed = all(id_ in family.places.declared.effects for id_ in ids)
    left = _distance(spec, noise_free, family, ids) if listed else 0.0
    found = [_distance(spec, noise_free, family, [other for other in ids if other != id_]) for id_ in ids]
    return [float(np.sqrt(max(d * d - left * left, 0.0))) for d in found]


def scaled_to(spec: TrialSpec, wanted: float, family: ModelicaFamily) -> TrialSpec:
    """Scale the one effect's magnitude so that its distance is about ``wanted``."""
    (effect,) = spec.truth.effects
    name = next(c.law.magnitude.name for c in family.places.candidates if c.id == effect.id)
    if effect.id == "amplifier_saturation":
        return spec
    for _ in range(2):
        noise_free = spec.noise_free().recording("train")
        d = _distance(spec, noise_free, family, [])
        if d < 0.5:
            # A twin of a base parameter: no size makes it visible.
            return spec
        factor = float(np.clip(wanted / max(d, 1e-3), 1e-3, 3.0))
        effect = EffectTruth(effect.id, effect.port, {**effect.parameters, name: effect.parameters[name] * factor})
        spec = replace(spec, truth=replace(spec.truth, effects=(effect,)))
        if 0.7 < factor < 1.4:
            break
    return spec


def _distance(spec: TrialSpec, noise_free: Recording, family: ModelicaFamily, known: Sequence[str]) -> float:
    model = family.base_model()
    shared = parameters_from_model(
        model, overrides={name: item for name, item in declared_overrides(model).items() if not item.free_if_identified}
    )
    loop = LoopSettings()
    settings = replace(loop.fitting.calibration, outputs=OUTPUTS, solver=SolverSettings(1e-6, 1e-6))
    read = calibrate([_as_read(spec, noise_free)], model, shared, settings=settings)
    (experiment,) = read.data.experiments
    assert experiment.measured is not None
    exact = noise_free.measured(experiment.outputs)[np.searchsorted(noise_free.time, experiment.time)]
    experiment = replace(experiment, measured=np.where(np.isnan(experiment.measured), np.nan, exact))
    plain = replace(read, data=read.data.with_experiments((experiment,)))
    with _here(plain.problem()) as simulator:
        every = range(len(plain.parameters))
        search = GlobalSearch(Objective(plain, simulator), loop.global_search)
        first = search.run(every, _here, np.random.default_rng(1)).optimum
    family.prepare(plain, first, _here)
    listed = [k for k in known if k in family.places.declared.effects]
    calibration, extra = plain, []
    if listed:
        offer = family.with_candidates(listed)
        names = {p.name for id_ in listed for p in family.parameters(id_)}
        calibration, extra = family.transfer(plain, offer.model), [p for p in offer.parameters if p.name in names]
    parameters = calibration.parameters.extended(extra)
    calibration = replace(calibration, parameters=parameters)
    truth = {name: value for e in spec.truth.effects for name, value in e.parameters.items()}
    values = [*plain.parameters.from_search(first.coordinates), *(truth.get(p.name, p.start) for p in extra)]
    with _here(calibration.problem()) as simulator:
        found = local_fit(
            Objective(calibration, simulator), parameters.to_search(np.array(values)), range(len(parameters)),
            noise=true_noise(spec), settings=LocalFitSettings(hold_noise=True),
        )  # fmt: skip
    return float(np.linalg.norm(found.whitened.residual))


def _here(problem: Problem) -> Simulator:
    return open_simulator(problem, workers=0)


def _as_read(spec: TrialSpec, noise_free: Recording) -> Recording:
    """Return the noise-free pitch as the encoder counts it, which says where it stands still."""
    counts = spec.sensors.encoder_counts
    if not counts:
        return noise_free
    step = 2.0 * np.pi / counts
    outputs = {**noise_free.outputs, "theta": np.floor(noise_free.outputs["theta"] / step + 0.5) * step}
    return replace(noise_free, outputs=outputs, sha256="")
