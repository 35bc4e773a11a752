"""Propose the experiment that reduces the uncertainty of weakly identified parameters most.

The expected posterior of a design is Gaussian: what is known already plus the Fisher information of the new recording
(Fedorov, 1972; Ljung, 1999, chapter 13), evaluated where the fit stands. What it is worth is the mean logarithm of
the standard deviations it leaves over those there are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.display import table_html
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.identifiability import Status
from aero_bayes.estimate.information import ExperimentPredictor, Limits, PredictedExperiment, posterior_sd
from aero_bayes.estimate.result import Fit, HasFit, fit_of
from aero_bayes.estimate.signal_search import SearchSettings, best_signals
from aero_bayes.files import write_whole
from aero_bayes.progress import Progress, Watched, watching
from aero_bayes.simulation.workers import WorkerPool

#: Families whose name is not what one calls their signals.
SIGNAL_PHRASES = {
    "binary": "a binary sequence", "square wave": "a square wave", "step and release": "a step and its release",
    "multi-sine": "a sum of sines", "chirp": "a chirp",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class ProposedInput:
    """An input by name; ``time`` (n,) in s and ``values`` (n,) in its unit, each held; the ``family`` it is of."""

    input: str
    time: FloatArray
    values: FloatArray
    family: str

    @property
    def table(self) -> dict[str, FloatArray]:
        """Times (k,) at which the input changes, and its values (k,) from then on."""
        changes = np.flatnonzero(np.diff(self.values, prepend=np.nan) != 0.0)
        return {"time": self.time[changes], self.input: self.values[changes]}

    @property
    def duration(self) -> float:
        """Length in s."""
        return float(self.time[-1] - self.time[0])

    @property
    def in_words(self) -> str:
        """Length and kind of the signal."""
        return f"{self.duration:g} s of {SIGNAL_PHRASES.get(self.family, self.family)}"

    def write_csv(self, path: Path | str) -> Path:
        """Write ``time`` and the input at every sample, as a recording has them; whole or not at all."""
        rows = [f"time,{self.input}"] + [f"{t:.9g},{v:.6g}" for t, v in zip(self.time, self.values, strict=True)]
        return write_whole(Path(path), "\n".join(rows) + "\n")


#: Posterior draws over which the proposal's travel must stay within its limit.
TRAVEL_DRAWS = 16
#: Share of the travel that the search may use at the fitted values, the rest being for what is not known.
TRAVEL_SHARE = 0.9


@dataclass(frozen=True)
class ExpectedParameter:
    """What a parameter's standard deviation is, and would be: SI units, and as a share of the value.

    ``repeated`` is what as long a recording of the present input would leave."""

    JSON_KEYS: ClassVar = "value unit sd_before sd_after sd_repeated gain target"

    name: str
    unit: str
    value: float
    sd_before: float
    sd_after: float
    sd_repeated: float
    target: bool

    @property
    def gain(self) -> float:
        """How many times narrower the interval would be."""
        return self.sd_before / self.sd_after


@dataclass(frozen=True, eq=False)
class Design(ProposedInput):
    """A proposed experiment."""

    JSON_KEYS: ClassVar = "input family families duration rate_hz gain travel limits seed unit parameters table"

    families: Mapping[str, float]
    expected: tuple[ExpectedParameter, ...]
    travel: Mapping[str, float]
    limits: Limits
    rate_hz: float
    seed: int
    unit: str = ""

    @property
    def targets(self) -> tuple[str, ...]:
        return tuple(e.name for e in self.expected if e.target)

    @property
    def gain(self) -> float:
        """How many times narrower the targets' intervals would be (geometric mean)."""
        return float(np.exp(np.mean([np.log(e.gain) for e in self.expected if e.target])))

    @property
    def parameters(self) -> dict[str, ExpectedParameter]:
        """Parameters by name."""
        return {e.name: e for e in self.expected}

    def __repr__(self) -> str:
        aims = ", ".join(self.targets)
        return f"<Design {self.input}: {self.family}, {self.time[-1]:g} s; {self.gain:.2g} times narrower {aims}>"

    def _repr_html_(self) -> str:
        rows = [
            (e.name, f"{e.value:.4g}", e.unit, f"{e.sd_before:.3g}", f"{e.sd_after:.3g}",
             f"{e.gain:.2f}{' *' if e.target else ''}")
            for e in self.expected
        ]  # fmt: skip
        head = ("parameter", "value", "unit", "sd now", "sd after", "times narrower")
        return table_html(head, rows, f"next experiment: {self.family}, {self.time[-1]:g} s, * aimed at")


def propose_experiment(
    fit: Fit | HasFit,
    *,
    duration: float = 30.0,
    rate_hz: float | None = None,
    limits: Limits | None = None,
    targets: Sequence[str] | None = None,
    settings: SearchSettings | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Design:
    """Return the input signal within given limits that reduces the uncertainty of weakly identified parameters most.

    Parameters
    ----------
    fit : Fit or LoopResult
    duration : float
        Length of the new recording in s.
    rate_hz : float, optional
        Its sample rate; that of the first recording by default.
    limits : Limits, optional
    targets : sequence of str, optional
        Parameters to narrow; by default those that are not identified, or all if all are. Optional ones that the fit
        did not free, such as an inductance at a low rate, must be named to be aimed at.
    settings : SearchSettings, optional
        Effort of the search, its seed, the engine.
    workers, progress
        As for a fit; an experiment that is asked for early is the best of those that were tried.

    Returns
    -------
    Design

    Raises
    ------
    InputError
        For a target that is no parameter of the fit, or a duration too short to sample.
    CannotFinishError
        If every candidate leaves the travel.

    Examples
    --------
    >>> from aero_bayes.estimate import Limits, SearchSettings
    >>> little = SearchSettings(start=2, rounds=1, candidates=2, families=1)
    >>> options = {"limits": Limits(5.0, {"position": 0.3}), "settings": little, "workers": 0}  # N, m
    >>> aero_bayes.propose_experiment(fit, duration=8.0, targets=["d"], **options).targets
    ('d',)
    """
    fit = fit_of(fit)
    limits, settings = limits or default_limits(fit), settings or SearchSettings()
    time = experiment_times(fit, duration, rate_hz)
    with WorkerPool(workers) as pool, watching(progress) as watched:
        predictor = ExperimentPredictor(fit, time, limits, settings.engine, workers, pool)
        return _best_design(fit, predictor, time, targets, settings, watched)


def _best_design(
    fit: Fit,
    predictor: ExperimentPredictor,
    time: FloatArray,
    targets: Sequence[str] | None,
    settings: SearchSettings,
    watched: Watched,
) -> Design:
    """Search over times (n,) in s for the best input, and keep it within its limits."""
    rng, amplifier = np.random.default_rng(settings.seed), predictor.limits.amplifier
    aimed, known = _targets(fit, predictor, targets), predictor.precision()
    before = posterior_sd(known)

    def score(signals: Sequence[FloatArray]) -> FloatArray:
        predicted = predictor.predict([amplifier * s for s in signals])
        return np.array([_score(p, known, before, aimed, predictor.limits) for p in predicted])

    found = best_signals(score, time, rng, settings, watched)
    if not np.isfinite(found[0].score):
        raise CannotFinishError("no candidate experiment stays within the travel; allow more of it")
    values, travel = within_travel(predictor, amplifier * found[0].values, rng)
    proposed, same = predictor.predict([values, _present(fit, predictor, time)])
    if proposed is None:
        raise CannotFinishError("the proposed experiment could not be simulated")
    after = posterior_sd(known + proposed.information)
    repeated = posterior_sd(known + same.information) if same is not None else np.full(after.shape, np.nan)
    slope = predictor.shared.jacobian(predictor.values)
    rows = np.stack([predictor.values, before * slope, after * slope, repeated * slope], axis=1).tolist()
    expected = tuple(
        ExpectedParameter(item.name, item.unit, value, now, later, again, j in aimed)
        for j, (item, (value, now, later, again)) in enumerate(zip(predictor.shared, rows, strict=True))
    )
    return Design(
        predictor.input, time, values, found[0].family.name, {f.family.name: f.score for f in found}, expected, travel,
        predictor.limits, float(1.0 / (time[1] - time[0])), settings.seed,
        fit.calibration.model.units[predictor.input],
    )  # fmt: skip


def default_limits(fit: Fit) -> Limits:
    """Return what the model's package allows, for those outputs that it has; else inputs as large as those recorded."""
    model, declared = fit.calibration.model, fit.calibration.model.declared.limits
    known = {v.name for v in model.outputs}
    experiments = fit.calibration.data.experiments
    largest = max((float(np.abs(s.values).max()) for e in experiments for s in e.inputs), default=0.0)
    return Limits(declared.input or largest or 1.0, {n: v for n, v in declared.travel.items() if n in known})


def experiment_times(fit: Fit, duration: float, rate_hz: float | None) -> FloatArray:
    """Return sample times of the new recording, shape (n,)."""
    if rate_hz is None:
        rate_hz = 1.0 / fit.calibration.data.intervals[0]
    if not (rate_hz > 0.0 and duration * rate_hz >= 10.0):
        raise InputError(f"an experiment of {duration:g} s at {rate_hz:g} Hz has fewer than ten samples")
    return np.arange(round(duration * rate_hz) + 1) / rate_hz


def within_travel(
    predictor: ExperimentPredictor, values: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, dict[str, float]]:
    """Make the signal smaller until draws of what is known keep to the travel; return each output's largest, too."""
    draws = np.vstack([predictor.values, predictor.draws(TRAVEL_DRAWS, rng)])
    rows = np.column_stack([draws, np.full(len(draws), predictor.delay_value)])
    for _ in range(30):
        with predictor.open(predictor.problem([predictor.experiment(values)])) as simulator:
            outputs = simulator.simulate(rows).outputs[0]
        travel = {
            n: float(np.nanmax(np.abs(outputs[:, :, predictor.outputs.index(n)]), initial=0.0))
            for n in predictor.limited
        }
        excess = max((travel[n] / limit for n, limit in predictor.limits.travel.items()), default=0.0)
        if np.all(np.isfinite(outputs)) and excess <= 1.0:
            return values, travel
        values = values * min(0.97, max(0.5, excess**-0.5) if np.isfinite(excess) else 0.5)
    raise CannotFinishError("the proposed experiment leaves the travel for some parameters that are still possible")


def _targets(fit: Fit, predictor: ExperimentPredictor, targets: Sequence[str] | None) -> list[int]:
    names = predictor.shared.names
    if targets is not None:
        for name in targets:
            if name not in names:
                raise InputError(f"{name} is no parameter of the fit; it has {', '.join(names)}")
        return [names.index(name) for name in targets]
    sought = [
        j for j, item in enumerate(predictor.shared) if not item.free_if_identified or item.name in fit.laplace.names
    ]
    table = fit.parameters
    return [j for j in sought if table[names[j]].status is not Status.IDENTIFIED] or sought


def _score(
    predicted: PredictedExperiment | None, known: FloatArray, before: FloatArray, aimed: list[int], limits: Limits
) -> float:
    """Compute the mean logarithm of the targets' standard deviations after over before; infinite beyond the travel."""
    if predicted is None or any(predicted.travel[n] > TRAVEL_SHARE * limit for n, limit in limits.travel.items()):
        return np.inf
    after = posterior_sd(known + predicted.information)
    return float(np.mean(np.log(after[aimed] / before[aimed])))


def _present(fit: Fit, predictor: ExperimentPredictor, time: FloatArray) -> FloatArray:
    """Return the first recording's input, repeated over the new times."""
    signal = fit.calibration.data.experiments[0].inputs[0]
    span = fit.calibration.data.experiments[0].time
    within = span[0] + np.mod(time, span[-1] - span[0])
    index = np.clip(np.searchsorted(signal.time, within, side="right") - 1, 0, signal.time.size - 1)
    return np.asarray(signal.values[index])
