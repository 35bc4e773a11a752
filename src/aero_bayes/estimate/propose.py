"""Propose the experiment that narrows weakly identified parameters most.

The expected posterior of a design is Gaussian: what is known already plus the Fisher information of the new recording
(Fedorov, 1972; Ljung, 1999, chapter 13), evaluated where the fit stands. What it is worth is the mean logarithm of
the standard deviations it leaves over those there are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from pydantic import Field

from aero_bayes.arrays import FloatArray
from aero_bayes.display import table_html
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.identifiability import Status
from aero_bayes.estimate.information import (
    ExperimentPredictor,
    Limits,
    PredictedExperiment,
    Score,
    SearchSettings,
    best_signal,
    posterior_sd,
)
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.estimate.result import Fit, HasFit, fit_of
from aero_bayes.files import write_whole
from aero_bayes.plain import INTERNAL, ByName, JsonNumber, JsonTable, Number, picked
from aero_bayes.progress import Progress, watching
from aero_bayes.simulation.workers import WorkerPool

#: Posterior draws over which the proposal's travel must stay within its limit.
TRAVEL_DRAWS = 16
#: Share of the travel that the search may use at the fitted values, the rest being for what is not known.
TRAVEL_SHARE = 0.9
#: Halvings of the largest input, at most, where no signal stays within the travel.
MOST_HALVINGS = 8


@dataclass(frozen=True)
class ExpectedParameter:
    """What a parameter's standard deviation is, and would be, in SI units.

    ``sd_repeated`` is what as long a recording of the present input would leave, ``gain`` how many times narrower the
    interval would be."""

    name: str = field(metadata=INTERNAL)
    unit: str
    value: Number
    sd_before: Number
    sd_after: Number
    sd_repeated: Number
    gain: Number
    target: bool


@dataclass(frozen=True, eq=False)
class Design:
    """A proposed experiment: an input by name, at ``time`` (n,) in s its ``values`` (n,) in its unit, each held.

    ``travel`` has the largest absolute value of each output that has a limit."""

    input: str
    time: FloatArray
    values: FloatArray
    travel: Mapping[str, float]
    limits: Limits
    seed: int
    expected: tuple[ExpectedParameter, ...]

    @property
    def duration(self) -> float:
        """Length in s."""
        return float(self.time[-1] - self.time[0])

    @property
    def table(self) -> dict[str, FloatArray]:
        """Times (k,) at which the input changes, and its values (k,) from then on."""
        at = np.flatnonzero(np.diff(self.values, prepend=np.nan) != 0.0)
        return {"time": self.time[at], self.input: self.values[at]}

    def write_csv(self, path: Path | str) -> Path:
        """Write ``time`` and the input at every sample, as a recording has them; whole or not at all."""
        rows = [f"time,{self.input}"] + [f"{t:.9g},{v:.6g}" for t, v in zip(self.time, self.values, strict=True)]
        return write_whole(Path(path), "\n".join(rows) + "\n")

    @property
    def rate_hz(self) -> float:
        return float(1.0 / (self.time[1] - self.time[0]))

    @property
    def targets(self) -> tuple[str, ...]:
        return tuple(e.name for e in self.expected if e.target)

    @property
    def gain(self) -> float:
        """How many times narrower the targets' intervals would be (geometric mean)."""
        return float(np.exp(np.mean([np.log(e.gain) for e in self.expected if e.target])))

    def to_dict(self) -> dict[str, object]:
        """Return the ``design`` entry of result.json."""
        return picked(DesignJson, self, parameters={e.name: e for e in self.expected})

    def __repr__(self) -> str:
        aims = ", ".join(self.targets)
        return f"<Design {self.input}: {self.time[-1]:g} s; {self.gain:.2g} times narrower {aims}>"

    def _repr_html_(self) -> str:
        rows = [
            (e.name, f"{e.value:.4g}", e.unit, f"{e.sd_before:.3g}", f"{e.sd_after:.3g}",
             f"{e.gain:.2f}{' *' if e.target else ''}")
            for e in self.expected
        ]  # fmt: skip
        head = ("parameter", "value", "unit", "sd now", "sd after", "times narrower")
        return table_html(head, rows, f"next experiment: {self.time[-1]:g} s, * aimed at")


class DesignJson(JsonTable):
    """The proposed experiment."""

    input: str
    unit: str = ""
    duration: float
    rate_hz: JsonNumber = None
    gain: JsonNumber = None
    parameters: ByName[ExpectedParameter] = Field(default_factory=dict)
    travel: dict[str, JsonNumber] = Field(default_factory=dict)
    limits: Limits
    table: dict[str, list[JsonNumber]] = Field(default_factory=dict)
    seed: int | None = None
    file: str = ""


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
    >>> little = SearchSettings(start=2, rounds=1, candidates=2)
    >>> options = {"limits": Limits(5.0, {"position": 0.3}), "settings": little, "workers": 0}  # N, m
    >>> aero_bayes.propose_experiment(fit, duration=8.0, targets=["d"], **options).targets
    ('d',)
    """
    fit = fit_of(fit)
    limits, settings = limits or default_limits(fit), settings or SearchSettings()
    time = _sample_times(fit, duration, rate_hz)
    with WorkerPool(workers) as pool:
        predictor = ExperimentPredictor(fit, time, limits, workers, pool)
        return _narrowing(predictor, _targets(fit, predictor.shared, targets), settings, progress)


def _narrowing(
    predictor: ExperimentPredictor, aimed: list[int], settings: SearchSettings, progress: Progress | None
) -> Design:
    """Search for the input that narrows some of the shared parameters, by their places."""
    known = predictor.precision()
    before = posterior_sd(known)

    def score(signals: Sequence[FloatArray]) -> FloatArray:
        """Compute the mean logarithm of the targets' standard deviations after over before."""
        predicted = predictor.predict(signals)
        spreads = [
            posterior_sd(known + p.information) if p and _allowed(p, predictor.limits) else None for p in predicted
        ]
        return np.array([np.inf if sd is None else float(np.mean(np.log(sd[aimed] / before[aimed]))) for sd in spreads])

    values, travel = _best_input(predictor, score, settings, progress)
    proposed, same = predictor.predict([values, _present(predictor)])
    if proposed is None:
        raise CannotFinishError("the proposed experiment could not be simulated")
    after = posterior_sd(known + proposed.information)
    repeated = np.full(after.shape, np.nan) if same is None else posterior_sd(known + same.information)
    spreads = np.stack([before, after, repeated]) * predictor.shared.jacobian(predictor.values)
    rows = np.vstack([predictor.values, spreads]).T.tolist()
    expected = tuple(
        ExpectedParameter(p.name, p.unit, value, now, later, again, now / later, j in aimed)
        for j, (p, (value, now, later, again)) in enumerate(zip(predictor.shared, rows, strict=True))
    )
    return Design(predictor.input, predictor.full_time, values, travel, predictor.limits, settings.seed, expected)


def expected_outputs(
    proposal: Design, fit: Fit, settings: SearchSettings, workers: int | None
) -> dict[str, FloatArray]:
    """Return what a fit expects of a proposal, without sensor noise: 5 %, 50 % and 95 % (3, n) over its posterior."""
    predictor = ExperimentPredictor(fit, proposal.time, proposal.limits, workers)
    runs = predictor.runs(proposal.values, predictor.draws(40, np.random.default_rng(settings.seed)), proposal.time)
    usable = runs.outputs[0][runs.outcomes[:, 0] == 0]
    if not len(usable):
        raise CannotFinishError("the proposed experiment could not be simulated")
    bands = np.quantile(usable, (0.05, 0.5, 0.95), axis=0)
    return {output: bands[:, :, k] for k, output in enumerate(predictor.outputs)}


def default_limits(fit: Fit) -> Limits:
    """Return what the model's package allows, for those outputs that it has; else inputs as large as those recorded."""
    model, declared = fit.calibration.model, fit.calibration.model.declared.limits
    known = {v.name for v in model.outputs}
    experiments = fit.calibration.data.experiments
    largest = max((float(np.abs(s.values).max()) for e in experiments for s in e.inputs), default=0.0)
    return Limits(declared.input or largest or 1.0, {n: v for n, v in declared.travel.items() if n in known})


def _sample_times(fit: Fit, duration: float, rate_hz: float | None) -> FloatArray:
    """Return sample times of the new recording, shape (n,)."""
    if rate_hz is None:
        rate_hz = 1.0 / fit.calibration.data.intervals[0]
    if not (rate_hz > 0.0 and duration * rate_hz >= 10.0):
        raise InputError(f"an experiment of {duration:g} s at {rate_hz:g} Hz has fewer than ten samples")
    return np.arange(round(duration * rate_hz) + 1) / rate_hz


def _allowed(predicted: PredictedExperiment, limits: Limits) -> bool:
    """Return whether an experiment keeps to the share of the travel that the search may use."""
    return all(predicted.travel[n] <= TRAVEL_SHARE * limit for n, limit in limits.travel.items())


def _best_input(
    predictor: ExperimentPredictor, score: Score, settings: SearchSettings, progress: Progress | None
) -> tuple[FloatArray, dict[str, float]]:
    """Return the best input, within the travel, and its travel."""
    rng, size = np.random.default_rng(settings.seed), predictor.limits.amplifier
    with watching(progress) as watched:
        for _ in range(MOST_HALVINGS):
            found, best = best_signal(partial(_of_size, score, size), predictor.full_time, rng, settings, watched)
            if np.isfinite(best) or watched.asked_to_end:
                break
            size *= 0.5
    if not np.isfinite(best):
        raise CannotFinishError("no candidate experiment stays within the travel; allow more of it")
    return _within_travel(predictor, size * found, rng)


def _of_size(score: Score, size: float, signals: Sequence[FloatArray]) -> FloatArray:
    """Score signals within plus and minus one as inputs of a size."""
    return score([size * values for values in signals])


def _within_travel(
    predictor: ExperimentPredictor, values: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, dict[str, float]]:
    """Make the signal smaller until draws of what is known keep to the travel; return each output's largest, too."""
    draws = np.vstack([predictor.values, predictor.draws(TRAVEL_DRAWS, rng)])
    for _ in range(30):
        outputs = predictor.runs(values, draws).outputs[0]
        travel = {
            n: float(np.nanmax(np.abs(outputs[:, :, predictor.outputs.index(n)]), initial=0.0))
            for n in predictor.limits.travel
        }
        excess = max((travel[n] / limit for n, limit in predictor.limits.travel.items()), default=0.0)
        if np.all(np.isfinite(outputs)) and excess <= 1.0:
            return values, travel
        values = values * min(0.97, max(0.5, excess**-0.5) if np.isfinite(excess) else 0.5)
    raise CannotFinishError("the proposed experiment leaves the travel for some parameters that are still possible")


def _targets(fit: Fit, shared: ParameterSet, targets: Sequence[str] | None) -> list[int]:
    """Return places among the shared parameters of those to narrow."""
    names = shared.names
    if targets is not None:
        for name in targets:
            if name not in names:
                raise InputError(f"{name} is no parameter of the fit; it has {', '.join(names)}")
        return [names.index(name) for name in targets]
    sought = [j for j, item in enumerate(shared) if not item.free_if_identified or item.name in fit.laplace.names]
    table = fit.parameters
    return [j for j in sought if table[names[j]].status is not Status.IDENTIFIED] or sought


def _present(predictor: ExperimentPredictor) -> FloatArray:
    """Return the first recording's input, repeated over the new times."""
    experiment = predictor.fit.calibration.data.experiments[0]
    signal, span = experiment.inputs[0], experiment.time
    within = span[0] + np.mod(predictor.full_time, span[-1] - span[0])
    index = np.clip(np.searchsorted(signal.time, within, side="right") - 1, 0, signal.time.size - 1)
    return np.asarray(signal.values[index])
