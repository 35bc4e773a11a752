"""What follows from the model structure of an FMU's description: Jacobian pattern, copies of states; and its checks."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from aero_bayes.errors import InputError
from aero_bayes.simulation.model_description import Variable, outputs_named_by_states

_STATE_SET = re.compile(r"(?:\$|_D_)STATESET")


def check_variables(path: Path, variables: Sequence[Variable]) -> None:
    """Raise InputError for what cannot be true of the variables of one model."""
    names = set[str]()
    for variable in variables:
        if variable.name in names:
            raise InputError(f"{path}: two variables have the name {variable.name!r}")
        names.add(variable.name)
        if not 0 <= variable.value_reference < 1 << 32:
            raise InputError(
                f"{path}: the value reference {variable.value_reference} of {variable.name!r} is not within 0..2^32-1"
            )
        if variable.minimum is not None and variable.maximum is not None and variable.minimum > variable.maximum:
            raise InputError(
                f"{path}: {variable.name!r} has the minimum {variable.minimum:g} above its maximum {variable.maximum:g}"
            )


def jacobian_pattern(
    depends: Sequence[set[int] | None], position: Mapping[int, int]
) -> tuple[tuple[int, ...], ...] | None:
    """Return, for each state the states whose derivative depends on it, from the knowns of each derivative."""
    if not depends or any(d is None for d in depends):
        return None
    rows = [{position[k] for k in d if k in position} for d in depends if d is not None]
    return tuple(tuple(i for i, row in enumerate(rows) if j in row) for j in range(len(rows)))


def refuse_selected_states(path: Path, states: Sequence[Variable]) -> None:
    """InputError where a state belongs to a set that the model selects while it runs."""
    for state in states:
        if _STATE_SET.match(state.name):
            raise InputError(
                f"{path}: {state.name!r} is selected while the model runs (dynamic state selection), which is not "
                "supported: choose the states in the source, with stateSelect = StateSelect.always or .prefer"
            )


def candidate_copies(
    outputs: Sequence[tuple[Variable, list[int] | None]], position: Mapping[int, int], states: Sequence[Variable]
) -> tuple[tuple[str, int], ...]:
    """Outputs that depend on one state and nothing else, or after which a state is named."""
    named = outputs_named_by_states(states)
    references = {state.value_reference for state in states}
    found = {}
    for variable, depends in outputs:
        if variable.kind != "real" or variable.value_reference in references:
            continue
        if variable.name in named:
            found[variable.name] = named[variable.name]
        elif depends is not None and len(depends) == 1 and depends[0] in position:
            found[variable.name] = position[depends[0]]
    return tuple(found.items())


def sha256(path: Path) -> str:
    """Checksum of a file."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
