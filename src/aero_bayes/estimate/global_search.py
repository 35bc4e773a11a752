"""Find the global optimum: particle swarm, local fits from several starts, delays, stages, then a check of the noise.

The command ``fit``, the noise model of the closed loop and every refit of a whole model use this search.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.checkpoint import Arrays, pack, unpack
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate import swarm as pso
from aero_bayes.estimate.delays import (
    better_delays,
    delay_columns,
    other_plateaus,
    scan_delays,
    with_few_samples,
    with_loose_solver,
)
from aero_bayes.estimate.intervals import with_robust_covariance
from aero_bayes.estimate.levenberg_marquardt import FitSettings, Stage, stages_by_effect
from aero_bayes.estimate.local_fit import (
    LocalFitSettings,
    OpenSimulator,
    Optimum,
    fit_noise,
    fit_progressive_horizon,
    local_fit,
)
from aero_bayes.estimate.log_posterior import LogPosterior
from aero_bayes.estimate.noise import (
    FALSE_ALARM_RATE,
    NoiseKind,
    OutputNoise,
    correlation_p_value,
    is_rotor_speed,
    ripple_means,
)
from aero_bayes.estimate.noise_estimation import estimate_noise, whiten
from aero_bayes.estimate.objective import Objective
from aero_bayes.plain import Number
from aero_bayes.progress import Progress, Watched


def correlated_outputs(objective: Objective, here: Optimum, noise: Mapping[str, OutputNoise]) -> set[str]:
    """Find outputs whose innovations are correlated over time, or with another output of the same recording.

    Sensors have noise of their own each. What two outputs have in common, and what one-step predictions leave of the
    past, is an error of the model. Outputs whose noise the user declares white are taken at that word."""
    units = objective.calibration.model.units
    turning = {s.experiment for s in objective.series if is_rotor_speed(s.measured, units[s.output])}
    innovations = []
    for series, residual in zip(objective.series, here.evaluation.residual, strict=True):
        rows, _ = whiten(residual[None], series.sampling, noise[series.output])
        rotor = series.experiment in turning
        innovations.append(ripple_means(rows[0], series.sampling.interval) if rotor else rows[0])
    pairs = [
        (j, k)
        for j, k in combinations_with_replacement(range(len(innovations)), 2)
        if objective.series[j].experiment == objective.series[k].experiment
        and innovations[j].size == innovations[k].size
    ]
    found: set[str] = set()
    for j, k in pairs:
        if correlation_p_value(innovations[j], innovations[k]) < FALSE_ALARM_RATE / len(pairs):
            found |= {objective.series[j].output, objective.series[k].output}
    return {output for output in found if objective.calibration.noise.kind(output) == "auto"}


def estimate_output_noise(
    objective: Objective, here: Optimum, white_outputs: Collection[str] = ()
) -> dict[str, OutputNoise]:
    """Estimate noise by its exact likelihood; for ``white_outputs``, weighted by their residual, by its RMS."""
    calibration, found = objective.calibration, dict(objective.calibration.known_noise)
    scale = dict(zip(calibration.data.outputs, calibration.data.scale.tolist(), strict=True))
    for output in (o for o in objective.outputs if o not in calibration.known_noise):
        own = [k for k, s in enumerate(objective.series) if s.output == output]
        white = output in white_outputs
        n = estimate_noise(
            [objective.series[k].sampling.time for k in own],
            [objective.series[k].sampling.equalised(here.evaluation.residual[k]) for k in own],
            "white" if white else calibration.noise.kind(output),
            here.noise[output],
            max(calibration.data.floors.get(output, 0.0), 1e-7 * scale[output]),
        )
        if (spread := calibration.data.spreads.get(output)) is not None:
            n = replace(n, sd_white=n.sd_white * spread.widening, sd_ou=n.sd_ou * spread.widening)
        found[output] = replace(n, model_error=True) if white else n
    return found


#: Noise of every output under Eq. 6, as a share of the smallest range of an output; it only sets the tolerances.
EQ6_NOISE_SHARE = 1e-3
#: Initial noise of an output, as a share of its range.
INITIAL_NOISE_SHARE = 0.03
#: Ratio of an output's RMS residual to that of a least-squares fit above which its noise model has absorbed signal.
MAX_RMS_RATIO = 1.05
#: Nats by which a point that the search has seen may be better than the one it reports: the noise of the solver.
MAX_SEEN_GAIN = 0.05
#: Plateaus of parameters that act in steps from which a fit is tried.
MAX_PLATEAUS = 8


@dataclass(frozen=True)
class StageReport(Stage):
    """Where a stage of the local search ended: cost, SI values, and RMS error by output over all recordings."""

    cost: Number
    values: Mapping[str, Number]
    rms: Mapping[str, Number]

    @classmethod
    def of(cls, stage: Stage, objective: Objective, end: Optimum) -> StageReport:
        """Report the optimum of a stage."""
        squares = objective.by_output(np.concatenate(end.evaluation.residual) ** 2)
        values = objective.parameters.from_search(end.coordinates).tolist()
        return cls(
            stage.parameters, stage.outputs, -end.log_likelihood - end.log_prior,
            dict(zip(objective.parameters.names, values, strict=True)),
            {output: float(np.sqrt(np.mean(rows))) for output, rows in squares.items() if rows.size},
        )  # fmt: skip


class GlobalSearch:
    """A global search of one objective, with the kind of noise that each output may have.

    It tells its swarm, its stages, and the log-posteriors of the local fits from several starts."""

    def __init__(self, objective: Objective, settings: FitSettings, progress: Progress | None = None) -> None:
        self.objective, self.settings = objective, settings
        self.progress = progress if isinstance(progress, Watched) else Watched(progress)
        calibration = objective.calibration
        self.kinds: dict[str, NoiseKind] = {o: self._kind(o) for o in calibration.data.outputs}
        self.white_outputs: set[str] = set()
        self.swarm: pso.SwarmResult | None = None
        self.stages: tuple[StageReport, ...] = ()
        self.iterations = 0
        self.seen: list[FloatArray] = []
        self.start_levels: tuple[float, ...] = ()

    def _kind(self, output: str) -> NoiseKind:
        wanted = self.objective.calibration.noise.kind(output)
        return "white" if self.settings.cost == "weighted" or wanted == "white" else "auto"

    @property
    def local_settings(self) -> LocalFitSettings:
        eq6 = self.settings.cost == "eq6"
        return LocalFitSettings(
            self.settings.last_search, self.kinds, self.objective.calibration.data.floors,
            hold_noise=eq6, prior=self.settings.cost == "posterior",
        )  # fmt: skip

    @property
    def least_squares_settings(self) -> LocalFitSettings:
        """Settings of a local least-squares fit: white noise of the size of the residual."""
        return self.local_settings.least_squares(self.kinds)

    def initial_noise(self) -> dict[str, OutputNoise]:
        """Choose the noise of each output at the start; under Eq. 6 it never changes."""
        scale = self.objective.calibration.data.scale
        same = EQ6_NOISE_SHARE * float(np.min(scale))
        eq6 = self.settings.cost == "eq6"
        return {
            name: OutputNoise(same if eq6 else INITIAL_NOISE_SHARE * float(scale[k]))
            for k, name in enumerate(self.objective.calibration.data.outputs)
        }

    @property
    def _held_noise(self) -> dict[str, OutputNoise] | None:
        """The noise that is never estimated: that of Eq. 6."""
        return self.initial_noise() if self.settings.cost == "eq6" else None

    def run(
        self, free: Sequence[int], open_simulator: OpenSimulator, rng: np.random.Generator,
        known: pso.SwarmResult | None = None,
    ) -> Optimum:  # fmt: skip
        """Search for the optimum over the free columns."""
        parameters = self.objective.parameters
        start = parameters.to_search(parameters.start)
        if self.settings.swarm is not None and len(free):
            start = self._explore(start, free, open_simulator, rng, known)
        steady = [j for j in free if j not in delay_columns(self.objective, free)]
        rough = self.local_settings.with_limits(12, 1.0)
        self.progress("local", 0.0, 0.0)
        held = self._held_noise
        here = self._best_plateau(self._local_fit(start, steady, held, rough), held, rough)
        point = scan_delays(self.objective, here, free)
        for k, stage in enumerate(self._stages(point, free)):
            self.progress("stages", k / 4.0, 0.0)
            point = self._fit_stage(stage, point, free)
        here = self._local_fit(point, free, held or here.noise, self.local_settings)
        self.progress("local", 0.5, -here.log_likelihood)
        here = self._search_delays(here, free)
        here = self._best_of_seen(self.settle_noise(here))
        whole = Stage(tuple(parameters.names[j] for j in free), self.objective.outputs)
        self.stages += (StageReport.of(whole, self.objective, here),)
        return here

    def refit(
        self, start: FloatArray, free: Sequence[int], noise: Mapping[str, OutputNoise], *, hold_noise: bool = False
    ) -> Optimum:
        """Fit locally from a point near the optimum; check the noise again, or hold it."""
        if hold_noise:
            return self._local_fit(start, free, noise, replace(self.local_settings, hold_noise=True))
        here = self._local_fit(start, free, noise, self.local_settings)
        return self.settle_noise(here)

    def seen_gains(self, here: Optimum) -> FloatArray:
        """Compute by how many nats each point where the search has been is better than an optimum, under its noise."""
        if not self.seen:
            return np.zeros(0)
        levels = self.objective.levels(np.array(self.seen), here.noise)
        own = here.whitened.log_likelihood + self._log_prior(here.coordinates, here.free)
        return np.array([w + self._log_prior(x, here.free) - own for w, x in zip(levels, self.seen, strict=True)])

    def _best_plateau(
        self, here: Optimum, noise: Mapping[str, OutputNoise] | None, settings: LocalFitSettings
    ) -> Optimum:
        """Fit from the plateaus of parameters that act in steps, which no local step could reach; returns the best."""
        found = [here]
        for point in other_plateaus(self.objective, here)[:MAX_PLATEAUS]:
            with suppress(CannotFinishError):
                found.append(self._local_fit(point, here.free, noise, settings))
        return max(found, key=lambda one: one.log_likelihood + one.log_prior)

    def _log_prior(self, point: FloatArray, free: Sequence[int]) -> float:
        if self.settings.cost != "posterior":
            return 0.0
        parameters = self.objective.parameters
        part = type(parameters)(tuple(parameters.items[j] for j in free))
        return float(part.log_prior(point[None, list(free)])[0])

    def _best_of_seen(self, here: Optimum) -> Optimum:
        """Choose the optimum, or one near a better point where the search has been: no step may lose what was found."""
        for _ in range(3):
            gains = self.seen_gains(here)
            if gains.max(initial=0.0) <= MAX_SEEN_GAIN:
                break
            again = self._local_fit(self.seen[int(np.argmax(gains))], here.free, here.noise, self.local_settings)
            here = self.settle_noise(again)
        return here

    def settle_noise(self, here: Optimum) -> Optimum:
        """Fit again with noise that can be the sensor's.

        Noise that is correlated for too long, that absorbs signal, or that leaves correlated innovations is model
        error."""
        if self.settings.cost != "posterior" or self.objective.filters:
            return here
        for _ in range(3):
            noise = estimate_output_noise(self.objective, here, self.white_outputs)
            new = {o for o, n in noise.items() if n.model_error} - self.white_outputs
            new = new or self._outputs_overfitted_by_noise(here, noise)
            new = new or correlated_outputs(self.objective, here, noise) - self.white_outputs
            if not new:
                break
            self.white_outputs |= new
            self.kinds |= dict.fromkeys(new, "white")
            here = self._local_fit(here.coordinates, here.free, None, self.local_settings)
        noise = estimate_output_noise(self.objective, here, self.white_outputs)
        here = self._local_fit(here.coordinates, here.free, noise, replace(self.local_settings, hold_noise=True))
        return with_robust_covariance(self.objective, here)

    def _outputs_overfitted_by_noise(self, here: Optimum, noise: Mapping[str, OutputNoise]) -> set[str]:
        """Find outputs whose correlated noise absorbs signal: least squares leaves noticeably smaller residuals."""
        correlated = {o for o, n in noise.items() if n.kind == "ou"}
        if not correlated:
            return set()
        squares = self._local_fit(here.coordinates, here.free, None, self.least_squares_settings)
        mine, least = (self._rms(o) for o in (here, squares))
        return {o for o in correlated if mine[o] > MAX_RMS_RATIO * least[o]}

    def _rms(self, found: Optimum) -> dict[str, float]:
        white = replace(self.least_squares_settings, floors={})
        return {o: n.sd_white for o, n in fit_noise(self.objective, found.evaluation.residual, white).items()}

    def _local_fit(
        self,
        start: FloatArray,
        free: Sequence[int],
        noise: Mapping[str, OutputNoise] | None,
        settings: LocalFitSettings,
        objective: Objective | None = None,
    ) -> Optimum:
        found = local_fit(
            objective or self.objective, start, free, noise=noise, settings=settings,
            on_iteration=lambda _, cost: self.progress.again(cost),
        )  # fmt: skip
        self.iterations += found.steps
        if not any(np.array_equal(found.coordinates, x) for x in self.seen):
            self.seen.append(found.coordinates)
        return found

    def _explore(
        self, start: FloatArray, free: Sequence[int], open_simulator: OpenSimulator, rng: np.random.Generator,
        known: pso.SwarmResult | None,
    ) -> FloatArray:  # fmt: skip
        """Search the whole box on a cheaper problem: a swarm, then local fits from its best particles and the start.

        This is a multi-start search; one more start comes from fitting progressively longer horizons."""
        assert self.settings.swarm is not None
        calibration, simulator = self.objective.calibration, self.objective.simulator
        reduced = with_loose_solver(with_few_samples(calibration, simulator, self.settings.swarm_samples))
        limit = self.settings.swarm.iterations
        values = self.objective.parameters.from_search(start)
        with open_simulator(reduced.problem()) as simulator:
            target = LogPosterior(reduced, simulator, values, free, prior=self.settings.cost == "posterior")
            reduced_objective = self.objective.with_calibration(reduced, simulator)
            rows = reduced_objective.noise_rows(self.initial_noise())
            low, high = target.box

            def run_swarm() -> Arrays:
                found = pso.minimise(
                    lambda x: target.cost(x, rows), low, high, rng, self.settings.swarm, start[list(free)][None],
                    lambda i, c: self.progress("swarm", (i + 1) / limit, c),
                )  # fmt: skip
                self.objective.outcomes.update(target.outcomes)
                return pack(found, "")

            key = (start, tuple(free), self.settings.cost, self.settings.swarm, rng.bit_generator.state)
            swarm = self.swarm = known or unpack(
                pso.SwarmResult,
                reduced_objective.cached("swarm", key, run_swarm, lambda: not self.progress.asked_to_end),
                "",
            )
            starts = [start]
            if np.isfinite(swarm.cost):
                for x in swarm.candidates[: self.settings.starts]:
                    at = start.copy()
                    at[list(free)] = x
                    starts.append(at)
                self.seen += starts[-1:] if self.settings.starts else []
            if self.settings.cost != "eq6":
                point, steps = fit_progressive_horizon(
                    reduced_objective, start, free, self.least_squares_settings.with_limits(12, 0.1), open_simulator
                )
                starts.append(point)
                self.iterations += steps
            best = self._best_local_fit(reduced_objective, starts, free)
        return best.coordinates

    def _best_local_fit(self, objective: Objective, starts: Sequence[FloatArray], free: Sequence[int]) -> Optimum:
        """Choose the best of several local fits with white noise."""
        settings = self.least_squares_settings.with_limits(25, 0.1)
        found = []
        for at in starts:
            with suppress(CannotFinishError):
                found.append(self._local_fit(at, free, self._held_noise, settings, objective))
        if not found:
            raise CannotFinishError(
                f"model {objective.calibration.model.name} could not be simulated at any starting point: "
                f"{objective.commonest_failure}"
            )
        levels = [o.log_likelihood + o.log_prior for o in found]
        self.start_levels = tuple(levels)
        return found[int(np.argmax(levels))]

    def _stages(self, point: FloatArray, free: Sequence[int]) -> tuple[Stage, ...]:
        """Return the user's stages, or stages by causality: parameters that move few outputs come first."""
        if not self.settings.staged or self.objective.filters:
            return ()
        if self.settings.stages is not None:
            return self.settings.stages
        return stages_by_effect(self.objective, point, free)

    def _fit_stage(self, stage: Stage, point: FloatArray, free: Sequence[int]) -> FloatArray:
        """Fit a stage's own parameters to its outputs."""
        parameters = self.objective.parameters
        own = [j for n in stage.parameters if (j := parameters.index(n)) in free]
        part = self.objective.with_outputs(stage.outputs)
        if not own or not part.series:
            return point
        found = self._local_fit(point, own, self._held_noise, self.local_settings.with_limits(20, 0.5), part)
        self.stages += (StageReport.of(stage, part, found),)
        return found.coordinates

    def _search_delays(self, here: Optimum, free: Sequence[int]) -> Optimum:
        """Move to better local optima of the delays, with all parameters refitted, as long as there are any."""
        for _ in range(3):
            point = better_delays(self.objective, here, free, prior=self.settings.cost == "posterior")
            if point is None:
                return here
            here = self._local_fit(point, free, here.noise, self.local_settings)
        return here
