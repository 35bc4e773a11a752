"""From starting values to the optimum: swarm, delays, stages, all together, and a least-squares check of the noise.

This is the one way to a fit: the command ``fit``, the closed loop's model as it stands and every refit of a whole model
take it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from aero_bayes.checkpoint import Arrays, pack, unpack
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate import swarm as pso
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.coarse import hurried, leading
from aero_bayes.estimate.delays import best_valleys, delay_columns, scan_delays
from aero_bayes.estimate.growing import OpenSimulator, grown, over_floor
from aero_bayes.estimate.interpolation import LEAST_GAIN, moving_inputs, read_as, with_lines
from aero_bayes.estimate.levenberg_marquardt import LocalSettings
from aero_bayes.estimate.local_fit import LocalFitSettings, Optimum, fit_noise, local_fit
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.staged import Stage, causal_stages
from aero_bayes.estimate.target import Target
from aero_bayes.sensors.noise import NoiseKind, OutputNoise, estimate_noise

FloatArray = NDArray[np.float64]
Progress = Callable[[str, float, float], None]
Cost = Literal["posterior", "weighted", "eq6"]

#: One standard deviation for every output under Eq. 6, as a share of the smallest range; it only sets the tolerances.
EQ6_UNIT = 1e-3
#: Share of an output's range that counts as noise before anything is known.
FIRST_GUESS = 0.03
#: Residual over the least-squares one above which a noise model has swallowed part of the signal.
SWALLOWED = 1.05
#: How many times the noise floor a fit leaves where another reading of the inputs may have led it to a wrong valley.
OFF = 1.5


@dataclass(frozen=True)
class AscentSettings:
    """How the optimum is looked for.

    Parameters
    ----------
    cost : {"posterior", "weighted", "eq6"}
    staged : bool
    stages : tuple of Stage, optional
    swarm : SwarmSettings, optional
        None leaves the swarm out.
    local : LocalSettings
    samples : int
        Samples a recording that the swarm sees.
    starts : int
        Particles that the local search starts from, besides the starting values.
    longest : float, optional
        Greatest correlation time of noise in s.
    settle : bool
        Whether the noise is estimated exactly and checked against least squares in the end.
    enough : float
        How many times the noise floor the residuals of a climb from the starting values may be for the swarm to be left
        out: no valley is deeper than the noise. By default it is never left out.
    """

    cost: Cost = "posterior"
    staged: bool = True
    stages: tuple[Stage, ...] | None = None
    swarm: pso.SwarmSettings | None = field(default_factory=pso.SwarmSettings)
    local: LocalSettings = field(default_factory=lambda: LocalSettings(tolerance=1e-4))
    samples: int = 600
    starts: int = 3
    longest: float | None = None
    settle: bool = True
    enough: float = 0.0


@dataclass(frozen=True, eq=False)
class StageEnd:
    """Where a stage ended: its log-posterior's negative, coordinates of all columns, residuals."""

    stage: Stage
    cost: float
    optimum: Optimum


@dataclass(frozen=True, eq=False)
class Ascent:
    """The optimum, with the way that led there."""

    optimum: Optimum
    swarm: pso.SwarmResult | None
    stages: tuple[StageEnd, ...]
    iterations: int


class Climber:
    """One ascent: an objective, its settings, and what each output's noise may be."""

    def __init__(self, objective: Objective, settings: AscentSettings, progress: Progress | None = None) -> None:
        self.objective, self.settings = objective, settings
        self.progress = progress or (lambda phase, share, cost: None)
        calibration = objective.calibration
        self.kinds: dict[str, NoiseKind] = {o: self._kind(o) for o in calibration.outputs}
        self.held: set[str] = set()
        self.stages: list[StageEnd] = []
        self.iterations = 0

    def _kind(self, output: str) -> NoiseKind:
        wanted = self.objective.calibration.noise.kind(output)
        return "white" if self.settings.cost == "weighted" or wanted == "white" else "auto"

    @property
    def climbing(self) -> LocalFitSettings:
        eq6 = self.settings.cost == "eq6"
        local = replace(self.settings.local, min_noise_gain=0.02, max_rejections=15, min_decrease=0.005)
        return LocalFitSettings(
            local, self.kinds, self.objective.calibration.floors,
            self.settings.longest, hold_noise=eq6, prior=self.settings.cost == "posterior",
        )  # fmt: skip

    @property
    def by_squares(self) -> LocalFitSettings:
        """As climbing, by the size of what is left."""
        return self.climbing.least_squares(self.kinds)

    def first_noise(self) -> dict[str, OutputNoise]:
        """Weights before anything is known; those of Eq. 6 for good."""
        scale = self.objective.calibration.scale
        same = EQ6_UNIT * float(np.min(scale))
        eq6 = self.settings.cost == "eq6"
        return {
            name: OutputNoise(same if eq6 else FIRST_GUESS * float(scale[k]))
            for k, name in enumerate(self.objective.calibration.outputs)
        }

    def to_optimum(
        self, free: Sequence[int], open_simulator: OpenSimulator, rng: np.random.Generator,
        known: pso.SwarmResult | None = None,
    ) -> Ascent:  # fmt: skip
        """From the parameters' starts to the optimum over the free columns; ``known`` spares the swarm.

        Raises
        ------
        CannotFinishError
            If the model cannot be simulated at any starting point.
        """
        start = self.objective.parameters.to_search(self.objective.parameters.start)
        swarm = None
        if self.settings.swarm is not None:
            start, swarm = self._valley(start, free, open_simulator, rng, known)
        steady = [j for j in free if j not in delay_columns(self.objective, free)]
        rough = self.climbing.with_limits(12, 1.0)
        self.progress("local", 0.0, 0.0)
        eq6 = self.first_noise() if self.settings.cost == "eq6" else None
        here = self._climb(start, steady, eq6, rough)
        point = scan_delays(self.objective, here, free)
        for k, stage in enumerate(self._stages(point, free)):
            self.progress("stages", k / 4.0, 0.0)
            point = self._stage(stage, point, free)
        here = self._climb(point, free, eq6 if eq6 else here.noise, self.climbing)
        self.progress("local", 0.5, -here.log_likelihood)
        here = self._other_valleys(here, free)
        here = self.settle(here)
        self.stages.append(
            StageEnd(Stage(tuple(self.objective.parameters.names[j] for j in free), self.objective.outputs),
                     -here.log_likelihood - here.log_prior, here)
        )  # fmt: skip
        return Ascent(here, swarm, tuple(self.stages), self.iterations)

    def again(self, start: FloatArray, free: Sequence[int], noise: Mapping[str, OutputNoise]) -> Optimum:
        """A climb from somewhere near, with the noise settled anew."""
        here = self._climb(start, free, noise, self.climbing)
        return self.settle(here)

    def settle(self, here: Optimum) -> Optimum:
        """The optimum under noise that is the sensor's: what lasts too long or swallows signal weighs as it is.

        Outputs whose noise cannot be the sensor's are weighed by the size of their residual, as least squares does.
        """
        if not self.settings.settle or self.settings.cost != "posterior":
            return here
        for _ in range(3):
            noise = self._estimated(here)
            new = {o for o, n in noise.items() if n.held} - self.held
            if not new:
                new = self._swallowing(here, noise)
            if not new:
                break
            self.held |= new
            self.kinds |= dict.fromkeys(new, "white")
            here = self._climb(here.coordinates, here.free, None, self.climbing)
        noise = self._estimated(here)
        return self._climb(here.coordinates, here.free, noise, replace(self.climbing, hold_noise=True))

    def _swallowing(self, here: Optimum, noise: Mapping[str, OutputNoise]) -> set[str]:
        """Outputs that least squares would follow noticeably better than the noise model lets the fit."""
        correlated = {o for o, n in noise.items() if n.kind == "ou"}
        if not correlated:
            return set()
        squares = self._climb(here.coordinates, here.free, None, self.by_squares)
        mine, least = (self._rms(o) for o in (here, squares))
        return {o for o in correlated if mine[o] > SWALLOWED * least[o]}

    def _rms(self, found: Optimum, objective: Objective | None = None) -> dict[str, float]:
        white = replace(self.by_squares, floors={})
        residual = found.evaluation.residual
        return {o: n.sd_white for o, n in fit_noise(objective or self.objective, residual, white).items()}

    def _estimated(self, here: Optimum) -> dict[str, OutputNoise]:
        """The noise by its exact likelihood; that of outputs which are held by their residual's size."""
        found = {}
        for output in self.objective.outputs:
            own = [k for k, s in enumerate(self.objective.series) if s.output == output]
            kind = self.objective.calibration.noise.kind(output)
            n = estimate_noise(
                [self.objective.series[k].sampling.time for k in own], [here.evaluation.residual[k] for k in own],
                "white" if output in self.held else kind, here.noise[output],
                max(self.objective.calibration.floors.get(output, 0.0), 1e-7 * self._scale(output)),
            )  # fmt: skip
            found[output] = replace(n, held=True) if output in self.held else n
        return found

    def _scale(self, output: str) -> float:
        calibration = self.objective.calibration
        return float(calibration.scale[calibration.outputs.index(output)])

    def _climb(
        self,
        start: FloatArray,
        free: Sequence[int],
        noise: Mapping[str, OutputNoise] | None,
        settings: LocalFitSettings,
        objective: Objective | None = None,
    ) -> Optimum:
        found = local_fit(objective or self.objective, start, free, noise=noise, settings=settings)
        self.iterations += found.steps
        return found

    def _valley(
        self, start: FloatArray, free: Sequence[int], open_simulator: OpenSimulator, rng: np.random.Generator,
        known: pso.SwarmResult | None,
    ) -> tuple[FloatArray, pso.SwarmResult | None]:  # fmt: skip
        """Search the whole box on a cheaper problem, then climb there from the best particles and from the start."""
        assert self.settings.swarm is not None
        cheap = hurried(leading(self.objective.calibration, self.objective.simulator, self.settings.samples))
        limit = self.settings.swarm.iterations
        values = self.objective.parameters.from_search(start)
        with open_simulator(cheap.problem()) as simulator:
            target = Target(cheap, simulator, values, free, prior=self.settings.cost == "posterior")
            few = self.objective.on(cheap, simulator)
            first = self.first_noise()
            near = self._near(few, start, free)
            if near is not None and over_floor(few, near.evaluation.residual) <= self.settings.enough:
                return near.coordinates, None
            rows = few.noise_rows(first)
            low, high = target.box

            def swarming() -> Arrays:
                found = pso.minimise(
                    lambda x: target.cost(x, rows), low, high, rng, self.settings.swarm, start[list(free)][None],
                    lambda i, c: self.progress("swarm", (i + 1) / limit, c),
                )  # fmt: skip
                self.objective.outcomes.update(target.outcomes)
                return pack(found, "")

            asked = (start, tuple(free), self.settings.cost, self.settings.swarm, rng.bit_generator.state)
            swarm = known or unpack(pso.SwarmResult, few.once("swarm", asked, swarming), "")
            starts = [] if near is not None else [start]
            if np.isfinite(swarm.cost):
                for x in swarm.candidates[: self.settings.starts]:
                    at = start.copy()
                    at[list(free)] = x
                    starts.append(at)
            if self.settings.cost != "eq6":
                point, steps = grown(few, start, free, self.by_squares.with_limits(12, 0.1), open_simulator)
                starts.append(point)
                self.iterations += steps
            best = self._best(few, starts, free, first, near)
        return best.coordinates, swarm

    def _near(self, objective: Objective, start: FloatArray, free: Sequence[int]) -> Optimum | None:
        """Where the starting values lead; None where nobody asks."""
        if self.settings.enough <= 0.0 or self.settings.cost == "eq6":
            return None
        with suppress(CannotFinishError):
            return self._climb(start, free, None, self.by_squares.with_limits(25, 0.1), objective)
        return None

    def _best(
        self, objective: Objective, starts: Sequence[FloatArray], free: Sequence[int], noise: Mapping[str, OutputNoise],
        near: Optimum | None,
    ) -> Optimum:  # fmt: skip
        """The best of several climbs with white noise, ``near`` among them."""
        eq6 = self.settings.cost == "eq6"
        found = [near] if near is not None else []
        for at in starts:
            with suppress(CannotFinishError):
                found.append(
                    self._climb(at, free, noise if eq6 else None, self.by_squares.with_limits(25, 0.1), objective)
                )
        if not found:
            raise CannotFinishError(
                f"model {objective.calibration.model.name} could not be simulated at any starting point: "
                f"{self.objective.commonest_failure}"
            )
        return max(found, key=lambda o: o.log_likelihood + o.log_prior)

    def _stages(self, point: FloatArray, free: Sequence[int]) -> tuple[Stage, ...]:
        """The user's stages, or those of causality: what moves few outputs first."""
        if not self.settings.staged:
            return ()
        if self.settings.stages is not None:
            return self.settings.stages
        parameters, calibration = self.objective.parameters, self.objective.calibration
        found = self.objective.evaluate(point, free)
        if found is None or found.slopes is None or len(calibration.outputs) == 1:
            return ()
        effect = np.zeros((len(free), len(calibration.outputs)))
        for k, series in enumerate(self.objective.series):
            size = np.max(np.abs(found.slopes[k]), axis=1) / calibration.scale[series.column]
            effect[:, series.column] = np.maximum(effect[:, series.column], size)
        names = [parameters.names[j] for j in free]
        stages = causal_stages(names, calibration.outputs, np.where(effect > 1e-6, effect, 0.0))
        return stages if len(stages) > 1 else ()

    def _stage(self, stage: Stage, point: FloatArray, free: Sequence[int]) -> FloatArray:
        """A climb on a stage's outputs over its own parameters."""
        parameters = self.objective.parameters
        own = [j for n in stage.parameters if (j := parameters.index(n)) in free]
        part = self.objective.part(stage.outputs)
        if not own or not part.series:
            return point
        eq6 = self.first_noise() if self.settings.cost == "eq6" else None
        found = self._climb(point, own, eq6, self.climbing.with_limits(20, 0.5), part)
        self.stages.append(StageEnd(stage, -found.log_likelihood - found.log_prior, found))
        return found.coordinates

    def _other_valleys(self, here: Optimum, free: Sequence[int]) -> Optimum:
        """Move to a better valley of the delays, other parameters following, as long as there is one."""
        if not delay_columns(self.objective, free):
            return here
        calibration = self.objective.calibration
        for _ in range(3):
            values = self.objective.parameters.from_search(here.coordinates)
            target = Target(
                calibration, self.objective.simulator, values, free, prior=self.settings.cost == "posterior"
            )
            point, moved = best_valleys(target, here.coordinates[list(free)], self.objective.noise_rows(here.noise))
            self.objective.outcomes.update(target.outcomes)
            if not moved:
                return here
            at = here.coordinates.copy()
            at[list(free)] = point
            here = self._climb(at, free, here.noise, self.climbing)
        return here


def straighter(
    climber: Climber, ascent: Ascent, open_simulator: OpenSimulator, rng: np.random.Generator
) -> tuple[Calibration, Optimum] | None:
    """The calibration with each input read as is likeliest, held or in straight lines; None if all hold as before.

    Held inputs may have led to a valley of their own, such as a resonance beyond half the sampling rate that shows at
    the samples as one below it: a fit that is far off is made anew with lines. Then each is read the other way alone.
    """
    before, here = climber.objective.calibration, ascent.optimum
    if (lines := with_lines(before)) is None:
        return None
    far = over_floor(climber.objective, here.evaluation.residual) > OFF
    found = _likelier(climber, here, lines, open_simulator, (rng, ascent.swarm) if far else None)
    best, here = (before, here) if found is None else (lines, found)
    moving = moving_inputs(before)
    for name in moving if len(moving) > 1 else ():
        other = read_as(best, {name: "hold" if best.interpolation[name] == "linear" else "linear"})
        found = _likelier(climber, here, other, open_simulator)
        best, here = (best, here) if found is None else (other, found)
    return None if best is before else (best, here)


def _likelier(
    climber: Climber, here: Optimum, other: Calibration, open_simulator: OpenSimulator,
    anew: tuple[np.random.Generator, pso.SwarmResult | None] | None = None,
) -> Optimum | None:  # fmt: skip
    """The best fit of another calibration, from the start if asked and else from an optimum, if it is the likelier."""
    enough = here.log_likelihood + LEAST_GAIN
    with open_simulator(other.problem()) as simulator:
        study = climber.objective.on(other, simulator)
        if anew is not None:
            with suppress(CannotFinishError):
                found = Climber(study, climber.settings).to_optimum(here.free, open_simulator, *anew).optimum
                if found.log_likelihood > enough:
                    return found
        found = Climber(study, climber.settings).again(here.coordinates, here.free, here.noise)
    return found if found.log_likelihood > enough else None
