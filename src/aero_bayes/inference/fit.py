"""From recordings to a fitted model: particle swarm, then bounded local search with the noise estimated alongside."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from aero_bayes.data import Recording
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.inference import cost as costs
from aero_bayes.inference import pso
from aero_bayes.inference.aero import aero_overrides
from aero_bayes.inference.calibration import Calibration, CalibrationSettings, calibrate
from aero_bayes.inference.delays import best_valleys
from aero_bayes.inference.identifiability import Identifiability, Status, assess
from aero_bayes.inference.laplace import Laplace, noise_covariance, parameter_covariance
from aero_bayes.inference.local import LocalSettings, Stop, search
from aero_bayes.inference.noise import NoiseEstimate, NoiseKind, NoiseModel, estimate_noise
from aero_bayes.inference.parameters import ParameterSet, parameters_from_model
from aero_bayes.inference.result import Fit, StageReport, structure_warnings
from aero_bayes.inference.ripple import without_ripple
from aero_bayes.inference.sensors import describe_sensors
from aero_bayes.inference.staged import Stage, causal_stages
from aero_bayes.inference.target import NoiseLayout, Target
from aero_bayes.simulation.interface import DelayTarget, Experiment, Outcome, Problem, Simulator
from aero_bayes.simulation.model import Model

FloatArray = NDArray[np.float64]
OpenSimulator = Callable[[Problem], Simulator]
Progress = Callable[[str, float, float], None]
Cost = Literal["posterior", "weighted", "eq6"]

#: One standard deviation for every output under Eq. 6, as a share of the smallest range; it only sets the tolerances.
EQ6_UNIT = 1e-3
#: Share of an output's range that counts as noise before anything is known; ignored outputs get IGNORED times it.
FIRST_GUESS, IGNORED = 0.03, 1e6


@dataclass(frozen=True)
class FitSettings:
    """How a fit is done.

    Parameters
    ----------
    method : {"chain", "pso", "local"}
        ``chain``: the swarm, then the local search from its best particles.
    cost : {"posterior", "weighted", "eq6"}
        What is minimised: the negative log-posterior, with correlated noise where the data show it; squared errors
        weighted by each output's white noise; or the paper's Eq. 6, squared errors as they are. The last two leave
        the priors out.
    staged : bool
        Let the local search fit in the direction of causality before it fits all together.
    stages : tuple of Stage, optional
        Stages in place of those that the model's own structure gives.
    swarm : SwarmSettings
    local : LocalSettings
    swarm_samples : int
        Samples a recording that the swarm sees.
    starts : int
        Particles that the local search starts from, besides the starting values.
    rounds : int
        Most alternations between parameters and noise.
    calibration : CalibrationSettings
    noise : NoiseModel
    ripple : {"subtract", "describe", "ignore"}
        Look for ripple locked to the rotor in the residuals. ``subtract`` takes what is found out of the readings and
        fits again, so that the noise is the sensor's; ``describe`` only says in the result how large it is and what
        the noise would be without it.
    """

    method: Literal["chain", "pso", "local"] = "chain"
    cost: Cost = "posterior"
    staged: bool = True
    stages: tuple[Stage, ...] | None = None
    swarm: pso.SwarmSettings = field(default_factory=pso.SwarmSettings)
    local: LocalSettings = field(default_factory=lambda: LocalSettings(tolerance=1e-4))
    swarm_samples: int = 600
    starts: int = 3
    rounds: int = 12
    calibration: CalibrationSettings = field(default_factory=CalibrationSettings)
    noise: NoiseModel = field(default_factory=NoiseModel)
    ripple: Literal["subtract", "describe", "ignore"] = "subtract"


def fit(
    recordings: Recording | Sequence[Recording],
    model: Model,
    *,
    parameters: ParameterSet | None = None,
    fixed: Mapping[str, float] | None = None,
    settings: FitSettings | None = None,
    seed: int = 1,
    engine: Literal["native", "fmpy"] = "native",
    workers: int | None = None,
    progress: Progress | None = None,
) -> Fit:
    """Fit a model to recordings.

    Parameters
    ----------
    recordings : Recording or sequence of Recording
    model : Model
    parameters : ParameterSet, optional
        What to search; the AERO's by default (:func:`aero_bayes.inference.aero.aero_overrides`).
    fixed : mapping of str to float, optional
        Model parameters to hold at other values than the model's own.
    settings : FitSettings, optional
    seed : int
    engine : {"native", "fmpy"}
    workers : int, optional
        Worker processes; all cores by default.
    progress : callable, optional
        Told a phase, how far it is (0 to 1), and the cost.

    Raises
    ------
    InputError
        If the recordings and the model do not belong together.
    CannotFinishError
        If the model cannot be simulated at any starting point.
    """
    from aero_bayes.simulation import open_simulator

    settings = settings or FitSettings()
    recordings = (recordings,) if isinstance(recordings, Recording) else tuple(recordings)
    if parameters is None:
        overrides = aero_overrides(model)
        if not overrides:
            raise InputError(f"model {model.name} is not an AERO: say which parameters to search")
        parameters = parameters_from_model(model, overrides=overrides)
    calibration = calibrate(
        recordings, model, parameters, fixed=fixed, noise=settings.noise, settings=settings.calibration
    )

    def opened(problem: Problem) -> Simulator:
        return open_simulator(problem, engine=engine, workers=workers)

    # Sums over BLAS threads differ in their last digits, and the same seed is to give the same numbers.
    with threadpool_limits(limits=1, user_api="blas"):
        found = fit_calibration(calibration, opened, settings, np.random.default_rng(seed), progress, engine=engine)
        return _with_sensors(found, opened, settings, progress, engine) if settings.cost == "posterior" else found


def _with_sensors(
    first: Fit,
    opened: OpenSimulator,
    settings: FitSettings,
    progress: Progress | None,
    engine: Literal["native", "fmpy"],
) -> Fit:
    """The fit with its sensors described; where ripple is to be subtracted, again from where it ended."""
    began = time.perf_counter()
    cleaned, ripple = without_ripple(first) if settings.ripple != "ignore" else (first.calibration.recordings, {})
    found, subtract = first, settings.ripple == "subtract"
    if ripple and subtract:
        start = replace(
            first.calibration,
            experiments=tuple(_cleaned(e, r, first.outputs) for e, r in zip(
                first.calibration.experiments, cleaned, strict=True
            )),
            recordings=cleaned,
            parameters=ParameterSet(tuple(
                replace(p, start=float(v)) for p, v in zip(first.calibration.parameters, first.values, strict=True)
            )),
        )  # fmt: skip
        again = fit_calibration(
            start, opened, replace(settings, method="local", staged=False), None, progress, engine=engine
        )
        outcomes = {o: again.outcomes.get(o, 0) + first.outcomes.get(o, 0) for o in Outcome}
        found = replace(
            again,
            calibration=replace(again.calibration, parameters=first.calibration.parameters),
            stages=first.stages + again.stages,
            swarm=first.swarm,
            iterations=first.iterations + again.iterations,
            outcomes=outcomes,
        )
    sensors = describe_sensors(found, ripple, subtracted=subtract)
    return replace(found, sensors=sensors, seconds=first.seconds + time.perf_counter() - began)


def _cleaned(experiment: Experiment, recording: Recording, outputs: Sequence[str]) -> Experiment:
    measured = np.array(experiment.measured)
    for column, name in enumerate(outputs):
        if name in recording.outputs:
            measured[:, column] = recording.outputs[name]
    return replace(experiment, measured=measured)


def fit_calibration(
    calibration: Calibration,
    open_simulator: OpenSimulator,
    settings: FitSettings | None = None,
    rng: np.random.Generator | None = None,
    progress: Progress | None = None,
    *,
    engine: Literal["native", "fmpy"] = "native",
    simulator: Simulator | None = None,
) -> Fit:
    """Fit a calibration through any simulator.

    ``simulator``, if given, is of the calibration's own problem and stays open; others are opened and closed here.
    """
    settings, rng = settings or FitSettings(), rng if rng is not None else np.random.default_rng(1)
    began = time.perf_counter()
    with ExitStack() as stack:
        # Simulations occupy every core; BLAS threads for matrices of a dozen rows would only fight them for it.
        stack.enter_context(threadpool_limits(limits=1, user_api="blas"))
        if simulator is None:
            simulator = stack.enter_context(open_simulator(calibration.problem()))
        run = _Run(calibration, simulator, settings, progress)
        starts = [calibration.parameters.start]
        swarm = None
        if settings.method != "local":
            swarm = run.swarm(open_simulator, rng)
            if np.isfinite(swarm.cost):
                starts = [run.full(x) for x in swarm.candidates[: settings.starts]] + starts
        if settings.method == "pso":
            run.values = starts[0]
            run.estimate_noise(calibration.outputs)
        else:
            run.local(starts, open_simulator)
        return run.finish(swarm, engine, time.perf_counter() - began)


class _Run:
    """State of one fit: the current values, noise and free columns."""

    def __init__(
        self, calibration: Calibration, simulator: Simulator, settings: FitSettings, progress: Progress | None
    ) -> None:
        self.calibration, self.simulator, self.settings = calibration, simulator, settings
        self.progress = progress or (lambda phase, share, cost: None)
        self.parameters = calibration.parameters
        self.values = self.parameters.start
        self.free = tuple(j for j, p in enumerate(self.parameters) if not p.auto)
        self.times = tuple(e.time for e in calibration.experiments)
        self.measured = calibration.measured
        self.noise = {
            name: NoiseEstimate(FIRST_GUESS * float(s))
            for name, s in zip(calibration.outputs, calibration.scale, strict=True)
        }
        self.outcomes: Counter[Outcome] = Counter()
        self.judging = False
        self.stages: list[StageReport] = []
        self.reason = Stop.ITERATION_LIMIT
        self.iterations = 0

    def target(self, free: Sequence[int] | None = None, simulator: Simulator | None = None) -> Target:
        target = Target(
            self.calibration, simulator or self.simulator, self.values, self.free if free is None else free,
            prior=self.settings.cost == "posterior",
        )  # fmt: skip
        target.outcomes = self.outcomes
        return target

    def full(self, coordinates: FloatArray) -> FloatArray:
        return np.asarray(self.target().values(coordinates[None])[0])

    def noise_rows(self, outputs: Sequence[str] | None = None) -> FloatArray:
        """Noise triples; outputs that are not asked for get so much noise that they do not count."""
        rows = []
        same = (EQ6_UNIT * float(np.min(self.calibration.scale)), 0.0, 0.0)
        for name, scale in zip(self.calibration.outputs, self.calibration.scale, strict=True):
            own = same if self.settings.cost == "eq6" and not self.judging else self.noise[name].as_row()
            rows.append(own if outputs is None or name in outputs else (IGNORED * float(scale), 0.0, 0.0))
        return np.array([[rows]])

    def swarm(self, open_simulator: OpenSimulator, rng: np.random.Generator) -> pso.SwarmResult:
        """Search the whole box on thinned data."""
        thin = self.calibration.thinned(self.settings.swarm_samples)
        limit = self.settings.swarm.iterations
        with open_simulator(thin.problem()) as simulator:
            target, noise = self.target(simulator=simulator), self.noise_rows()
            low, high = target.box
            return pso.minimise(
                lambda x: target.cost(x, noise), low, high, rng, self.settings.swarm,
                target.parameters.to_search(self.values[list(self.free)])[None],
                lambda i, c: self.progress("swarm", (i + 1) / limit, c),
            )  # fmt: skip

    def local(self, starts: Sequence[FloatArray], open_simulator: OpenSimulator) -> None:
        """Several starts on thinned data, then causal stages and all together on the full data."""
        self._thinned_search(starts, open_simulator)
        self._scan_delays()
        stages = self._stages()
        for index, stage in enumerate(stages):
            self.progress("stages", index / (len(stages) + 1), 0.0)
            self._stage(stage)
        self._scan_delays()
        self._everything()
        self._other_valleys()
        if self._free_what_shows():
            self._everything()

    def _everything(self) -> None:
        names = tuple(self.parameters.names[j] for j in self.free)
        self._stage(Stage(names, self.calibration.outputs), joint=True)

    def _thinned_search(self, starts: Sequence[FloatArray], open_simulator: OpenSimulator) -> None:
        thin = self.calibration.thinned(2 * self.settings.swarm_samples)
        with open_simulator(thin.problem()) as simulator:
            target, noise = self.target(simulator=simulator), self.noise_rows()
            points = np.stack([target.parameters.to_search(v[list(self.free)]) for v in starts])
            result = search(
                lambda x: target.products(x, noise), points, *target.box, self.settings.local,
                lambda x: target.cost(x, noise),
            )  # fmt: skip
        if not np.isfinite(result.cost[result.best]):
            worst = max((o for o in self.outcomes if o is not Outcome.OK), key=lambda o: self.outcomes[o])
            raise CannotFinishError(
                f"model {self.calibration.model.name} could not be simulated at any starting point: {worst.text}"
            )
        self.values = self.full(result.points[result.best])

    def _other_valleys(self) -> None:
        """Move to a better valley of the delays, other parameters following, as long as there is one."""
        intervals = [float(np.median(np.diff(t))) for t in self.times]
        for _ in range(3):
            target = self.target()
            point = target.parameters.to_search(self.values[list(self.free)])
            point, moved = best_valleys(target, point, self.noise_rows(), intervals, self.settings.local)
            if not moved:
                return
            self.values = target.values(point[None])[0]
            self._everything()

    def _scan_delays(self) -> None:
        """The likelihood has a narrow valley between every two samples in a delay: look into each of them."""
        columns = [j for j, p in enumerate(self.parameters) if isinstance(p.target, DelayTarget) and j in self.free]
        if not columns:
            return
        limit = max(self.parameters.items[j].upper for j in columns)
        interval = min(float(np.median(np.diff(t))) for t in self.times)
        grid = np.linspace(0.0, limit, int(np.clip(4 * limit / interval, 40, 160)) + 1)
        values = np.tile(self.values, (grid.size + 1, 1))
        for j in columns:
            values[:-1, j] = np.minimum(grid, self.parameters.items[j].upper)
        likelihood = self.simulator.log_likelihood(values, self.noise_rows()).log_likelihood
        for j in columns:
            own = self.parameters.items[j].recording
            per = likelihood[:, own] if own is not None else likelihood.sum(axis=1)
            self.values = self.values.copy()
            self.values[j] = values[int(np.argmax(per)), j]

    def _stages(self) -> tuple[Stage, ...]:
        if not self.settings.staged:
            return ()
        if self.settings.stages is not None:
            return self.settings.stages
        trajectories = self.simulator.simulate(self.values[None], active=self.free)
        if trajectories.sensitivities is None or not np.all(trajectories.outcomes == Outcome.OK):
            return ()
        slope = self.parameters.jacobian(self.values)[list(self.free)]
        scale = self.calibration.scale
        effect = np.zeros((len(self.free), len(self.calibration.outputs)))
        for sensitivity in trajectories.sensitivities:
            effect = np.maximum(effect, np.max(np.abs(sensitivity[0]), axis=0).T)
        effect *= slope[:, None] / scale
        names = [self.parameters.names[j] for j in self.free]
        stages = causal_stages(names, self.calibration.outputs, np.where(effect > 1e-6, effect, 0.0))
        return stages if len(stages) > 1 else ()

    def _stage(self, stage: Stage, *, joint: bool = False) -> None:
        """Alternate between parameters and noise on a stage's outputs."""
        free = tuple(self.parameters.index(n) for n in stage.parameters if self.parameters.index(n) in self.free)
        if not free:
            return
        target = self.target(free)
        point = target.parameters.to_search(self.values[list(free)])
        kinds: tuple[NoiseKind, ...] = ("auto",) if joint else ("white", "auto")
        before = np.inf
        for kind in kinds:
            for turn in range(self.settings.rounds):
                self.estimate_noise(stage.outputs, kind)
                noise = self.noise_rows(stage.outputs)
                result = search(
                    partial(target.products, noise=noise), point[None], *target.box, self.settings.local,
                    partial(target.cost, noise=noise),
                )  # fmt: skip
                if result.reasons[0] is Stop.FAILED_START:
                    break
                point = result.points[0]
                self.values = target.values(point[None])[0]
                self.reason, self.iterations = result.reasons[0], self.iterations + int(result.iterations[0])
                if joint:
                    self.progress("local", (turn + 1) / self.settings.rounds, float(result.cost[0]))
                if abs(before - result.cost[0]) < (0.02 if joint else 1.0):
                    break
                before = float(result.cost[0])
                if kind == "white" and turn >= 1:
                    break
        self.estimate_noise(stage.outputs)
        self.stages.append(self._report(stage, target.products(point[None], self.noise_rows(stage.outputs)).cost[0]))

    def _report(self, stage: Stage, cost: float) -> StageReport:
        residual = costs.residuals(self.measured, self._fitted())
        rms = costs.rms_overall(residual, self.calibration.outputs)
        return StageReport(stage, float(cost), {n: float(v) for n, v in self._named().items()}, rms)

    def _named(self) -> dict[str, float]:
        return dict(zip(self.parameters.names, self.values.tolist(), strict=True))

    def _fitted(self) -> tuple[FloatArray, ...]:
        result = self.simulator.simulate(self.values[None])
        return tuple(y[0] for y in result.outputs)

    def estimate_noise(self, outputs: Sequence[str], kind: NoiseKind | None = None) -> None:
        """Noise of some outputs from the residuals at the current values."""
        if self.settings.cost == "eq6" and not self.judging:
            return
        residual = costs.residuals(self.measured, self._fitted())
        for k, name in enumerate(self.calibration.outputs):
            if name not in outputs:
                continue
            wanted = self.calibration.noise.kind(name)
            if kind == "white" or wanted == "white" or (self.settings.cost == "weighted" and not self.judging):
                wanted = "white"
            columns = [r[:, k] for r in residual]
            guess = self.noise[name] if self.noise[name].kind == "ou" and not self.noise[name].held else None
            self.noise[name] = estimate_noise(self.times, columns, wanted, guess, 1e-7 * self.calibration.scale[k])

    def _free_what_shows(self) -> bool:
        """Free each optional parameter that the data would narrow to a third of its prior."""
        optional = [j for j, p in enumerate(self.parameters) if p.auto]
        if not optional:
            return False
        columns = tuple(sorted({*self.free, *optional}))
        verdict = self._assess(columns)
        shown = [j for j in optional if verdict.status[self.parameters.names[j]] is Status.IDENTIFIED]
        self.free = tuple(sorted({*self.free, *shown}))
        return bool(shown)

    def _assess(self, columns: tuple[int, ...]) -> Identifiability:
        target = self.target(columns)
        point = target.parameters.to_search(self.values[list(columns)])
        information = target.products(point[None], self.noise_rows(), with_prior=False).hessian[0]
        return assess(
            target.parameters.names, self.values[list(columns)], [p.scale == "log" for p in target.parameters],
            information, target.parameters.prior_sd(),
        )  # fmt: skip

    def finish(self, swarm: pso.SwarmResult | None, engine: str, seconds: float) -> Fit:
        """Judge what was found and put it together: with the noise as it is, whatever the search minimised."""
        self.judging = True
        if self.settings.cost != "posterior":
            self.estimate_noise(self.calibration.outputs)
        optional = tuple(j for j, p in enumerate(self.parameters) if p.auto)
        verdict = self._assess(tuple(sorted({*self.free, *optional})))
        blind = {self.parameters.index(name) for name in verdict.no_effect}
        self.values = np.where([j in blind for j in range(len(self.values))], self.parameters.start, self.values)
        sampled = tuple(j for j in self.free if j not in blind)
        target = self.target(sampled)
        point = target.parameters.to_search(self.values[list(sampled)])
        noise = self.noise_rows()
        products = target.products(point[None], noise)
        fitted = self._fitted()
        residual = costs.residuals(self.measured, fitted)
        layout = NoiseLayout.of(self.calibration, self.noise)
        covariance = np.zeros((len(sampled) + layout.size,) * 2)
        covariance[: len(sampled), : len(sampled)] = parameter_covariance(
            products.hessian[0], target.parameters.prior_sd()
        )
        covariance[len(sampled) :, len(sampled) :] = noise_covariance(layout, self.times, residual, self.noise)
        log_likelihood = float(np.sum(target.log_likelihood(point[None], noise)))
        return Fit(
            calibration=self.calibration,
            values=self.values,
            free=sampled,
            noise=dict(self.noise),
            identifiability=verdict,
            laplace=Laplace(
                target.parameters.names + layout.names,
                np.concatenate([point, layout.pack(self.noise)]),
                covariance,
                len(sampled),
            ),
            log_likelihood=log_likelihood,
            log_posterior=log_likelihood + float(target.parameters.log_prior(point[None])[0]),
            fitted=fitted,
            residuals=residual,
            stages=tuple(self.stages),
            swarm=swarm,
            reason=self.reason,
            iterations=self.iterations,
            outcomes={o: int(self.outcomes[o]) for o in Outcome},
            warnings=structure_warnings(self.calibration, residual, self.noise),
            seconds=seconds,
            engine=engine,
        )
