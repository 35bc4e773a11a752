"""The diagnosis of a fit: which of five causes may be behind a residual that is not noise. One check a cause."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.display import join_names, table_html, with_unit
from aero_bayes.errors import InputError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.exports import noise_by_recording
from aero_bayes.estimate.identifiability import Status
from aero_bayes.estimate.levenberg_marquardt import Stop
from aero_bayes.estimate.noise import FALSE_ALARM_RATE, autocorrelation
from aero_bayes.estimate.residual_tests import ResidualReport, exact_level, structured_residuals
from aero_bayes.modelica.rumoca_front import load_flat
from aero_bayes.modelica.syntax import Call, Expression, Number, names_in, walk
from aero_bayes.plain import INTERNAL
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.interface import Outcome
from aero_bayes.simulation.model import Model

if TYPE_CHECKING:
    from aero_bayes.estimate.result import Fit

Cause = Literal["data", "solver", "search", "noise", "model"]
#: In this order causes are looked at. The model comes last: it is blamed only where the others are clear.
CAUSES: tuple[Cause, ...] = ("data", "solver", "search", "noise", "model")


@dataclass(frozen=True)
class DiagnosisRow:
    """What was looked at and found of one cause."""

    cause: Cause
    found: bool
    what: str
    where: str = ""
    done: str = ""
    explains: bool = field(default=False, metadata=INTERNAL)
    more: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """The row as text, with its first finding and how many there are beside it."""
        where = f" ({self.where})" if self.where else ""
        more = f" And {len(self.more)} more, see the diagnosis." if self.more else ""
        return f"{self.what.removesuffix('.')}{where}.{' ' if self.done else ''}{self.done}{more}"


@dataclass(frozen=True)
class Diagnosis:
    """The five causes in order, with what was found of each."""

    rows: tuple[DiagnosisRow, ...] = ()

    def __iter__(self) -> Iterator[DiagnosisRow]:
        return iter(self.rows)

    def __getitem__(self, cause: Cause) -> DiagnosisRow:
        return next(row for row in self.rows if row.cause == cause)

    @property
    def first(self) -> DiagnosisRow | None:
        """The first cause that was found; None for a fit without a fault."""
        return next((row for row in self.rows if row.found), None)

    @property
    def explanation(self) -> DiagnosisRow | None:
        """The first cause before the model that may explain a structured residual."""
        return next((row for row in self.rows if row.found and row.explains and row.cause != "model"), None)

    @property
    def line(self) -> str:
        """One line for a terminal: the state of each cause."""
        return "diagnosis: " + ", ".join(f"{row.cause} {'FOUND' if row.found else 'clear'}" for row in self.rows)

    def _repr_html_(self) -> str:
        rows = [
            (r.cause, "found" if r.found else "clear", " ".join((r.what, *r.more)), r.where, r.done) for r in self.rows
        ]
        return table_html(("cause", "", "what", "where", "done"), rows, "Diagnosis")

    def __repr__(self) -> str:
        return f"<{self.line[:1].upper()}{self.line[1:]}>"


def check_data(fit: Fit) -> DiagnosisRow:
    """Tell what is wrong with the readings of the fitted recordings."""
    findings = list(dict.fromkeys(f for recording in fit.calibration.data.recordings for f in recording.findings))
    if not findings:
        return DiagnosisRow(
            "data", False, "No impossible or stuck readings, outliers, clipping, gaps in time or jumps of a whole turn."
        )
    findings.sort(key=lambda f: f.mended)
    first, more = findings[0], tuple(f.sentence for f in findings[1:])
    # Other values, constants and an input's noise may do what a missing effect does: effects are still looked for.
    explains = not first.mended and first.kind not in ("value", "offset", "noise", "feedback")
    return DiagnosisRow("data", True, first.what, first.where, first.done, explains, more)


def check_model(fit: Fit) -> DiagnosisRow:
    """Tell which residuals are more than noise."""
    structured = structured_residuals(fit.reports)
    if not structured:
        return DiagnosisRow("model", False, "The residual of every output is noise.")
    names = ", ".join(f"`{name}`" for name in sorted({report.output for report in structured}))
    where = ", ".join(dict.fromkeys(report.recording for report in structured))
    return DiagnosisRow("model", True, f"The residual of {names} is more than noise.", f"in {where}", explains=True)


#: Share of rounding in the variance of a residual from which it is told: below, the noise smooths the steps.
MIN_ROUNDED_SHARE = 0.25


def check_noise(fit: Fit) -> DiagnosisRow:
    """Tell which outputs have noise that is not white."""
    if fit.calibration.data.spreads:
        return _unequal_row(fit)
    if fit.reports and all(report.exact for report in fit.reports):
        sizes = ", ".join(f"{o} {rms:.1g}" for o, rms in fit.rms.items())
        return DiagnosisRow("noise", False, f"There is no noise at all: what is left ({sizes}) is rounding.")
    counts = {o: sensor.encoder for o, sensor in fit.sensors.items() if sensor.encoder is not None}
    rounded = {o: own.step for o, own in counts.items() if own.share >= MIN_ROUNDED_SHARE}
    if rounded:
        units = fit.calibration.model.units
        where = ", ".join(f"{o}: steps of {with_unit(f'{step:.3g}', units.get(o, ''))}" for o, step in rounded.items())
        return DiagnosisRow("noise", True, f"{join_names(list(rounded))} is rounded to coarse counts.", where)
    correlated = {o: n for o, n in fit.noise.items() if n.kind == "ou"}
    alternating = [(report.output, _alternation(fit, report)) for report in structured_residuals(fit.reports)]
    if alternating and all(size for _, size in alternating):
        told = join_names([f"those of {o} alternate, with a correlation of {size:.2g}" for o, size in alternating])
        what = f"Successive errors leave no pattern but this: {told}."
        done = "What the inputs do between two samples does so, and no missing effect: record them more often."
        return DiagnosisRow("noise", True, what, "", done, explains=True)
    if not correlated:
        return DiagnosisRow("noise", False, "The noise was taken as white in every output.")
    return DiagnosisRow(
        "noise", True, f"The noise of {join_names(list(correlated))} is correlated over time.",
        ", ".join(f"{o}: over {n.tau:.3g} s" for o, n in correlated.items()), "Intervals use it.",
    )  # fmt: skip


#: Correlation of successive errors that alternate at most, how many more lags show nothing, and fewest errors.
MAX_ALTERNATION, LAGS_AFTER, MIN_ALTERNATING = -0.1, 4, 50


def _alternation(fit: Fit, report: ResidualReport) -> float:
    """Return the correlation of successive errors where these alternate and show nothing else; 0 elsewhere.

    Means and other readings of an input that changes within its samples leave this."""
    data = fit.calibration.data
    k = next(
        k for k, s in enumerate(fit.series)
        if (data.names[s.experiment], s.output) == (report.recording, report.output)
    )  # fmt: skip
    experiment, residual = data.experiments[fit.series[k].experiment], fit.optimum.evaluation.residual[k]
    moving = any(np.count_nonzero(np.diff(s.values)) > 0.5 * experiment.time.size for s in experiment.inputs)
    others = [p for name, p in report.tests.items() if name != "autocorrelation"]
    if not moving or residual.size < MIN_ALTERNATING or min(others, default=1.0) < FALSE_ALARM_RATE:
        return 0.0
    lags = autocorrelation(residual, 1 + LAGS_AFTER)[1:]
    scatter = 3.0 / residual.size**0.5
    clear = lags[0] < min(MAX_ALTERNATION, -scatter) and np.all(np.abs(lags[1:]) < scatter)
    return float(lags[0]) if clear else 0.0


def _unequal_row(fit: Fit) -> DiagnosisRow:
    """Tell which outputs have noise that differs from reading to reading, and by how much."""
    units = fit.calibration.model.units
    kinds, where = [], []
    for output, spread in fit.calibration.data.spreads.items():
        unit = units.get(output, "")
        if spread.scales:
            kinds.append(f"The noise of {output} differs by recording.")
            own = noise_by_recording(fit.calibration.data, output, fit.noise[output].sd)
            where.append(f"{output}: " + ", ".join(f"{with_unit(f'{sd:.2g}', unit)} in {r}" for r, sd in own.items()))
        if spread.kind == "relative":
            kinds.append(f"The noise of {output} grows with the reading.")
            base = f"{'-' if spread.base < 0.0 else '+'} {with_unit(f'{abs(spread.base):.2g}', unit)}"
            where.append(f"{output}: sd = {spread.per_unit:.2g} |{output}| {base}")
        elif spread.kind == "student":
            kinds.append(f"The noise of {output} has heavy tails.")
            where.append(
                f"{output}: Student t of scale {spread.base:.2g} {unit}, {spread.freedom:.2g} degrees of freedom"
            )
    return DiagnosisRow("noise", True, " ".join(kinds), "; ".join(where), "Fit and intervals use it.")


#: Difference of two log-posteriors up to which two fits are at the same cost; fewest starts of which it tells anything.
SAME_LEVEL, MIN_STARTS = 3.0, 4


def check_search(fit: Fit) -> DiagnosisRow:
    """Tell which other optima there are, whether starts disagree, and which parameters ended on a bound."""
    bounds = [name for name, status in fit.identifiability.status.items() if status is Status.AT_BOUND]
    if fit.reason is Stop.INTERRUPTED:
        what = "The search was interrupted before it had converged, so that its residual says little of the model."
        return DiagnosisRow("search", True, what, "", "Fit again and let it end.", explains=True)
    if fit.modes:
        where = f"also {len(bounds)} on a bound" if bounds else ""
        done = "A posterior has draws of each; bounds or a prior that exclude the others leave one answer."
        return DiagnosisRow("search", True, fit.modes_sentence, where, done)
    agree = sum(max(fit.start_levels) - level < SAME_LEVEL for level in fit.start_levels) if fit.start_levels else 0
    count = len(fit.start_levels)
    # Where the residual is noise, the best end is the right one, however few starts lead there.
    if agree == 1 and count >= MIN_STARTS and structured_residuals(fit.reports):
        what = f"Of {count} local fits from different starts only one reached the best cost."
        done = "A larger swarm ([fit.pso] particles) or narrower bounds would show whether there is a better one."
        return DiagnosisRow("search", True, what, "", done)
    if not bounds:
        ends = f" {agree} of {count} starts of the local search ended at the best cost." if count > 1 else ""
        return DiagnosisRow("search", False, f"Every parameter ended inside its range.{ends}")
    # A model that lacks an effect drives parameters to bounds, too, so that a bound alone explains no residual.
    return DiagnosisRow(
        "search", True, f"The best value of {join_names(bounds)} lies on a bound of the search range.",
        ", ".join(f"{name} = {fit[name].value:.4g}" for name in bounds), "Widen the bounds if they are not physical.",
    )  # fmt: skip


#: Functions that are not defined for every number, and what a user can write in their place.
DOMAINS = {
    "sqrt": "a root of a negative number", "log": "a logarithm of a number that is not positive",
    "log10": "a logarithm of a number that is not positive", "asin": "an arc sine of a number beyond 1",
    "acos": "an arc cosine of a number beyond 1",
}  # fmt: skip
#: Functions that keep an argument inside a domain.
GUARDS = {"max", "min", "abs", "noEvent", "smooth", "exp"}
#: Halvings of a recording in which the time of a failure is looked for: to a thousandth of it.
HALVINGS = 10
#: Expressions that are named.
MAX_NAMED = 3


def domain_texts(model: Model) -> list[str]:
    """List expressions without a guard that may leave their domain, with file and line; none without a known source."""
    found: dict[str, None] = {}
    if model.source is None:
        return []
    with suppress(InputError, RecursionError):
        flat = load_flat(model.source.name, model.source.files, model.source.libraries)
        constants = {v.name for v in flat.variables if v.constant}
        for equation in flat.equations:
            where = f" in {equation.place}" if equation.place is not None else ""
            told = (_leaves(tree, constants) for tree in (*walk(equation.left), *walk(equation.right)))
            found |= dict.fromkeys(f"{what}{where}" for what in told if what)
    return list(found)


def _leaves(tree: Expression, constants: set[str]) -> str:
    """Return what an expression may do with values outside its domain; empty where it has none, or a guard."""
    if not isinstance(tree, Call):
        return ""
    root = tree.function == "^" and isinstance(tree.args[1], Number) and not float(tree.args[1].value).is_integer()
    if tree.function not in DOMAINS and not root:
        return ""
    inner = tree.args[0]
    varying = sorted(names_in(inner) - constants)
    if not varying or any(isinstance(t, Call) and t.function in GUARDS for t in walk(inner)):
        return ""
    name = tree.function if tree.function in DOMAINS else "power"
    return f"{DOMAINS.get(tree.function, DOMAINS['sqrt'])}, {name} of {' and '.join(varying)},"


def failing_run(fit: Fit) -> str:
    """Return values, recording and time at which a run fails.

    The start of the search if it fails, else a point near the fit."""
    calibration = fit.calibration
    parameters = calibration.parameters
    rows = [parameters.start, fit.values]
    with open_simulator(calibration.problem(), workers=0) as simulator:
        outcomes = simulator.simulate(np.array(rows)).outcomes
    for row, what, own in zip(rows, ("the start values", "the fitted values"), outcomes, strict=True):
        failed = np.flatnonzero(own != Outcome.OK)
        if failed.size:
            values = ", ".join(f"{p.name} = {v:.4g}" for p, v in zip(parameters, row.tolist(), strict=True))
            time = _time_of_failure(calibration, row, int(failed[0]))
            return f"{calibration.data.names[int(failed[0])]} at {time:.4g} s with {what}, {values}"
    return ""


def _time_of_failure(calibration: Calibration, row: FloatArray, index: int) -> float:
    """Return the time in s up to which a recording can be simulated."""
    data = calibration.data
    experiment = data.experiments[index]
    good, bad = 1, experiment.time.size
    for _ in range(HALVINGS):
        if bad - good <= 1:
            break
        middle = (good + bad) // 2
        part = experiment.at_samples(slice(middle))
        experiments = (*data.experiments[:index], part, *data.experiments[index + 1 :])
        shorter = replace(calibration, data=data.with_experiments(experiments))
        with open_simulator(shorter.problem(), workers=0) as simulator:
            ran = simulator.simulate(row[np.newaxis]).outcomes[0, index] == Outcome.OK
        good, bad = (middle, bad) if ran else (good, middle)
    return float(experiment.time[min(bad, experiment.time.size) - 1])


#: Share of failed runs up to which they are the far corners of a search, which no answer depends on.
MAX_FAILED_SHARE = 0.2
#: RMS by which a ten times tighter tolerance moves an output, as a share of the RMS residual, up to which the solver's
#: error is hidden: a tenth adds half a percent to the residual, and is too small to bias a parameter by much.
MAX_SOLVER_SHARE = 0.1
#: Standard deviations by which the solver's error moves a parameter from which the answer is another one: a bias of
#: half of one makes a 90 % interval hold 86 %.
MAX_SHIFT = 0.5
#: Share of the structured part of a residual from which the solver's error may be all of it: the tighter run has an
#: error, too, and the fitted parameters take up some of it.
EXPLAINING_SHARE = 0.5


def check_solver(fit: Fit) -> DiagnosisRow:
    """Tell which share of simulations failed and why, or which output moves when the solver works more tightly."""
    runs = sum(fit.outcomes.values())
    failed = {o: count for o, count in fit.outcomes.items() if o is not Outcome.OK and count}
    what = f"All {runs} runs were completed."
    if failed:
        share, commonest = sum(failed.values()) / runs, max(failed, key=lambda o: failed[o])
        what = f"{sum(failed.values())} of {runs} runs failed, most of them because {commonest.text}."
        if share > MAX_FAILED_SHARE:
            return _failed_row(fit, what, commonest)
    moved = _moved_outputs(fit)
    if moved and _changes_the_answer(fit, moved):
        return _tolerance_row(fit, moved)
    if moved:
        shift = max(fit.solver_shift.values(), default=0.0)
        what = (
            f"{what} A ten times tighter tolerance moves {join_names(list(moved))} by more than a tenth of its "
            f"residual, but no parameter by more than {shift:.1g} of its standard deviation."
        )
    elif fit.solver_difference:
        what = f"{what} A ten times tighter tolerance moves no output by more than a tenth of its residual."
    return DiagnosisRow("solver", False, what)


def _failed_row(fit: Fit, what: str, commonest: Outcome) -> DiagnosisRow:
    """Tell where runs fail, and which equations may be the reason."""
    domains = domain_texts(fit.calibration.model) if commonest in (Outcome.NOT_FINITE, Outcome.SOLVER_FAILED) else []
    done = ""
    if domains:
        what = f"{what} The equations may take {'; '.join(domains[:MAX_NAMED]).rstrip(',')}."
        done = "Keep the argument in its domain, as by sqrt(max(x, 0)), so that the search can use these values, too."
    return DiagnosisRow("solver", True, what, failing_run(fit), done, explains=True)


def _moved_outputs(fit: Fit) -> dict[str, float]:
    """Compute the RMS by which outputs move at ten times tighter tolerances, where it is a share of what is left."""
    rms, solver = fit.rms, fit.calibration.solver
    level = {
        output: max((exact_level(solver, s) for s in fit.series if s.output == output), default=0.0) for output in rms
    }
    return {
        output: size
        for output, size in fit.solver_difference.items()
        if size > MAX_SOLVER_SHARE * max(rms[output], level[output])
    }


def _changes_the_answer(fit: Fit, moved: dict[str, float]) -> bool:
    """Tell whether the solver's error moves a parameter by a clear share of its sd, or is what is left."""
    if max(fit.solver_shift.values(), default=0.0) > MAX_SHIFT:
        return True
    if any(size > EXPLAINING_SHARE * fit.rms[output] for output, size in moved.items()):
        return True
    return bool(structured_residuals(fit.reports)) and _explains(fit, moved)


def _tolerance_row(fit: Fit, moved: dict[str, float]) -> DiagnosisRow:
    """Tell which outputs move at a ten times tighter tolerance."""
    rms = fit.rms
    units = fit.calibration.model.units
    sizes = (f"{with_unit(f'{size:.2g}', units.get(output, ''))} rms" for output, size in moved.items())
    shares = (f"{size / rms[output]:.2g} times its residual" for output, size in moved.items())
    where = "; ".join(f"{o} moves by {size}, {share}" for o, size, share in zip(moved, sizes, shares, strict=True))
    furthest = max(fit.solver_shift, key=lambda name: fit.solver_shift[name], default="")
    if furthest:
        where = f"{where}; {furthest} by {fit.solver_shift[furthest]:.2g} standard deviations"
    tolerance = 0.1 * fit.calibration.solver.relative_tolerance
    return DiagnosisRow(
        "solver", True, "A ten times tighter tolerance of the solver changes the answer.", where,
        f"Tighten [solver] relative_tolerance and absolute_tolerance, as to {tolerance:.0e}, and fit again.",
        _explains(fit, moved),
    )  # fmt: skip


def _explains(fit: Fit, moved: dict[str, float]) -> bool:
    """Return whether the solver's error is of the size of what the noise does not explain in each output that moves."""
    for output, size in moved.items():
        noise = [sd**2 for (_, name), sd in fit.floors.items() if name == output]
        structured = max(fit.rms[output] ** 2 - (float(np.mean(noise)) if noise else 0.0), 0.0)
        if size**2 < EXPLAINING_SHARE**2 * structured:
            return False
    return True


#: One check for each cause, in their order.
CHECKS: tuple[Callable[[Fit], DiagnosisRow], ...] = (
    check_data, check_solver, check_search, check_noise, check_model
)  # fmt: skip


def diagnose(fit: Fit) -> Diagnosis:
    """Look at each cause of a residual that is not noise."""
    return Diagnosis(tuple(check(fit) for check in CHECKS))
