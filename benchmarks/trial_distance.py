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

from aero_bayes.bench.trial import TrialSpec
from aero_bayes.bench.truth import EffectTruth
from aero_bayes.data import Recording
from aero_bayes.estimate import calibrate, declared_overrides, parameters_from_model
from aero_bayes.estimate.ascent import Climber
from aero_bayes.estimate.climb import ClimbSettings, climb
from aero_bayes.estimate.objective import Objective
from aero_bayes.loop import LoopSettings
from aero_bayes.physics.catalogue import candidates_of
from aero_bayes.physics.family import ModelFamily
from aero_bayes.sensors.noise import OutputNoise
from aero_bayes.simulation import open_simulator
from aero_bayes.simulation.interface import Problem, Simulator, SolverSettings

OUTPUTS = ("i_m", "omega_m", "theta")


def true_noise(spec: TrialSpec) -> dict[str, OutputNoise]:
    """Noise of each output; an encoder's counts add the variance of their width, ripple counts as removable."""
    noise = {}
    for output in OUTPUTS:
        item = getattr(spec.sensors, output)
        white = item.white
        if output == "theta" and spec.sensors.encoder_counts:
            white = float(np.hypot(white, 2.0 * np.pi / spec.sensors.encoder_counts / np.sqrt(12.0)))
        noise[output] = OutputNoise(white, item.slow, item.slow_time) if item.slow > 0.0 else OutputNoise(white)
    return noise


def distances(spec: TrialSpec, silent: Recording, family: ModelFamily, ids: Sequence[str]) -> list[float]:
    """Distance of each effect, the others of the truth being known to the model (catalogue effects only)."""
    if not ids:
        return []
    left = _distance(spec, silent, family, ids) if all(id_ in family.declared.catalogue for id_ in ids) else 0.0
    found = [_distance(spec, silent, family, [other for other in ids if other != id_]) for id_ in ids]
    return [float(np.sqrt(max(d * d - left * left, 0.0))) for d in found]


def scaled_to(spec: TrialSpec, wanted: float, family: ModelFamily) -> TrialSpec:
    """The trial with its one effect's magnitude changed so that its distance is about ``wanted``."""
    (effect,) = spec.truth.effects
    name = family.declared.effect(effect.id).magnitude.name
    if effect.id == "amplifier_saturation":
        return spec
    for _ in range(2):
        silent = spec.silent().recording("train")
        d = _distance(spec, silent, family, [])
        if d < 0.5:
            # A twin of a base parameter: no size makes it visible.
            return spec
        factor = float(np.clip(wanted / max(d, 1e-3), 1e-3, 3.0))
        effect = EffectTruth(effect.id, effect.port, {**effect.parameters, name: effect.parameters[name] * factor})
        spec = replace(spec, truth=replace(spec.truth, effects=(effect,)))
        if 0.7 < factor < 1.4:
            break
    return spec


def _distance(spec: TrialSpec, silent: Recording, family: ModelFamily, known: Sequence[str]) -> float:
    model = family.screening()
    shared = parameters_from_model(
        model, overrides={name: item for name, item in declared_overrides(model).items() if not item.auto}
    )
    loop = LoopSettings()
    settings = replace(loop.calibration, outputs=OUTPUTS, solver=SolverSettings(1e-6, 1e-6))
    read = calibrate([_as_read(spec, silent)], model, shared, settings=settings)
    (experiment,) = read.experiments
    assert experiment.measured is not None
    exact = silent.measured(experiment.outputs)[np.searchsorted(silent.time, experiment.time)]
    experiment = replace(experiment, measured=np.where(np.isnan(experiment.measured), np.nan, exact))
    base = read.parameters
    highest = float(np.abs(silent.inputs["V_m"]).max())
    listed = [k for k in known if k in family.declared.catalogue]
    extra = [p for _, own in candidates_of(family.declared, listed, OUTPUTS, highest).values() for p in own]
    parameters = base.extended(extra)
    calibration = replace(read, experiments=(experiment,), parameters=parameters)
    with _here(calibration.problem()) as simulator:
        objective = Objective(calibration, simulator)
        first = Climber(objective, loop.ascent).to_optimum(range(len(base)), _here, np.random.default_rng(1)).optimum
        start = first.coordinates.copy()
        truth = {name: value for e in spec.truth.effects for name, value in e.parameters.items()}
        for item in extra:
            if item.name in truth:
                start[parameters.index(item.name)] = parameters.to_search(
                    np.array([truth.get(p.name, p.start) for p in parameters])
                )[parameters.index(item.name)]
        found = climb(
            objective, start, range(len(parameters)), noise=true_noise(spec), settings=ClimbSettings(hold_noise=True)
        )
    return float(np.linalg.norm(found.whitened.residual))


def _here(problem: Problem) -> Simulator:
    return open_simulator(problem, workers=0)


def _as_read(spec: TrialSpec, silent: Recording) -> Recording:
    """The noise-free pitch as the encoder counts it, which says where it stands still."""
    counts = spec.sensors.encoder_counts
    if not counts:
        return silent
    step = 2.0 * np.pi / counts
    outputs = {**silent.outputs, "theta": np.floor(silent.outputs["theta"] / step + 0.5) * step}
    return replace(silent, outputs=outputs, sha256="")
