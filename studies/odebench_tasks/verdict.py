"""Whether what a loop names is the term that was deleted."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import sympy
from numpy.typing import NDArray

from odebench_tasks.recordings import trajectory
from odebench_tasks.systems import Task

FloatArray = NDArray[np.float64]

#: Largest difference of a named term from the deleted one over what was visited, as a share of the deleted one.
MAX_DIFFERENCE = 0.05


def verdict(task: Task, loop: Mapping[str, Any], modelica: str) -> str:
    """Return ``right``, ``in class``, ``place``, ``false`` or ``silent`` for what a loop names.

    A curve names no term. It tells a place, and is false at another one.

    Parameters
    ----------
    task : Task
    loop : mapping
        Of ``result.json``.
    modelica : str
        The extended model; empty where there is none.
    """
    if not loop["effects"]:
        return "silent"
    states = trajectory(task.system, task.system.starts[0])
    if task.term is None or states is None:
        return "false"
    values = {name: one["value"] for effect in loop["effects"] for name, one in effect["parameters"].items()}
    texts = {effect["port"]: effect.get("text", "") for effect in loop["effects"]}
    for instance, parameter in re.findall(r"(\w+)\([^()]*\bu = (c_\d+)[,)]", modelica):
        modelica = modelica.replace(f"{instance}.y", f"({texts.get(parameter, '')})")
    added = _added(task, modelica, values, states)
    if added is not None and is_term(task, added, states):
        return "right"
    if len(loop["effects"]) == 1:
        (effect,) = loop["effects"]
        if effect["kind"] == "free_form" and effect["port"] == task.system.states[task.term.state]:
            return "place"
        for text in effect.get("alternatives", []):
            product, _, port = text.rpartition(" at ")
            alone = {port: over(product, task.system.states, states)}
            if all(v is not None for v in alone.values()) and is_term(task, alone, states):  # type: ignore[arg-type]
                return "in class"
    return "false"


def over(text: str, names: Sequence[str], states: FloatArray) -> FloatArray | None:
    """Return values (n,) of an expression over states (n, s); None where it has other names or no values."""
    symbols = sympy.symbols(list(names), real=True)
    try:
        tree = sympy.sympify(
            text.replace("^", "**"), locals=dict(zip(names, symbols, strict=True)) | {"abs": sympy.Abs}
        )
        if tree.free_symbols - set(symbols):
            return None
        with np.errstate(all="ignore"):
            found = np.broadcast_to(sympy.lambdify(symbols, tree, "numpy")(*states.T), (len(states),)).astype(float)
    except (TypeError, ValueError, AttributeError, sympy.SympifyError):
        return None
    return found if np.all(np.isfinite(found)) else None


def _added(task: Task, modelica: str, values: Mapping[str, float], states: FloatArray) -> dict[str, FloatArray] | None:
    """Return what the extended model has in its rates beyond the first one, by state.

    None where that cannot be told.
    """
    rates = dict(re.findall(r"der\((x_\d)\) = ([^;]*);", modelica))
    first = dict(re.findall(r"der\((x_\d)\) = ([^;]*);", task.first_model.modelica(task.system.starts[0], None)))
    constants = dict(task.first_model.constants) | dict(values)
    found = {}
    for state, text in rates.items():
        pair = []
        for one in (text, first[state]):
            for name, value in constants.items():
                one = re.sub(rf"\b{name}\b", f"({value!r})", one)
            pair.append(over(one, task.system.states, states))
        if pair[0] is None or pair[1] is None:
            return None
        found[state] = pair[0] - pair[1]
    return found


def is_term(task: Task, added: Mapping[str, FloatArray], states: FloatArray) -> bool:
    """Return whether a term is added to the right rate only, and is the deleted one but for its coefficient."""
    assert task.term is not None
    where = task.system.states[task.term.state]
    if any(np.ptp(v) > 0.0 or v[0] != 0.0 for state, v in added.items() if state != where) or where not in added:
        return False
    constants = {sympy.Symbol(n): v for n, v in task.system.constants.items()}
    true = over(str(task.term.value.subs(constants)), task.system.states, states)
    found = added[where]
    if true is None or not found.any():
        return False
    scale = float(found @ true) / float(found @ found)
    return float(np.linalg.norm(scale * found - true)) <= MAX_DIFFERENCE * float(np.linalg.norm(true))
