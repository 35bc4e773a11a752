"""Why runs of a model fail: where in time, at which values, and which expressions of its equations have a domain."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.result import Fit
from aero_bayes.export import FlatModel, load_flat
from aero_bayes.language.syntax import Call, Expression, Number, names_in, walk
from aero_bayes.simulation import open_simulator
from aero_bayes.simulation.interface import Outcome
from aero_bayes.simulation.model import Model

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
    if model.source is None:
        return []
    with suppress(InputError, RecursionError):
        return _in_equations(load_flat(model.source.name, model.source.files, model.source.libraries))
    return []


def _in_equations(flat: FlatModel) -> list[str]:
    constants = {v.name for v in flat.variables if v.constant}
    found: dict[str, None] = {}
    for equation in flat.equations:
        for tree in (*walk(equation.left), *walk(equation.right)):
            what = _leaves(tree, constants)
            if what:
                where = f" in {equation.place}" if equation.place is not None else ""
                found.setdefault(f"{what}{where}")
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
        measured = experiment.measured[:middle] if experiment.measured is not None else None
        part = replace(experiment, time=experiment.time[:middle], measured=measured)
        experiments = (*data.experiments[:index], part, *data.experiments[index + 1 :])
        shorter = replace(calibration, data=data.with_experiments(experiments))
        with open_simulator(shorter.problem(), workers=0) as simulator:
            ran = simulator.simulate(row[np.newaxis]).outcomes[0, index] == Outcome.OK
        good, bad = (middle, bad) if ran else (good, middle)
    return float(experiment.time[min(bad, experiment.time.size) - 1])
