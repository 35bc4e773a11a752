"""Why a name of a model cannot be fitted: it is computed from other parameters, or is no real number."""

from __future__ import annotations

from contextlib import suppress

from aero_bayes.display import join_names
from aero_bayes.errors import InputError
from aero_bayes.export import FlatModel, load_flat
from aero_bayes.language.syntax import Call, Expression, Name, names_in, short_text
from aero_bayes.simulation.model import Model
from aero_bayes.unknown_names import known_names_hint

_SIGNS = ("+", "-", "*", "/", "^")


def no_parameter_text(model: Model, name: str) -> str:
    """One line that says why a model has no parameter of this name that can be fitted."""
    known = [v.name for v in model.parameters]
    if model.source is not None:
        with suppress(InputError, RecursionError):
            flat = load_flat(model.source.name, model.source.files, model.source.libraries)
            if reason := _reason(flat, name, known):
                return reason
    return f"model {model.name} has no parameter {name}{known_names_hint(name, sorted(known))}"


def _reason(flat: FlatModel, name: str, known: list[str]) -> str:
    v = next((v for v in flat.variables if v.name == name and v.constant), None)
    if v is None:
        return ""
    if v.type != "Real":
        return (
            f"parameter {name} of model {flat.name} is of type {v.type} and cannot be searched: fit a class that "
            f"extends the model with each of its values, and compare the errors"
        )
    behind = sorted(names_in(v.binding) & set(known)) if v.binding is not None else []
    if v.binding is None or not behind:
        return ""
    return (
        f"parameter {name} of model {flat.name} is computed: {name} = {_text(v.binding)}; "
        f"fit {join_names(behind)} in its place"
    )


def _text(tree: Expression) -> str:
    """An expression as it is written in Modelica, with more parentheses than needed."""
    if isinstance(tree, Call) and tree.function in _SIGNS and len(tree.args) == 2:
        left, right = (f"({_text(a)})" if isinstance(a, Call) and a.function in _SIGNS else _text(a) for a in tree.args)
        return f"{left} {tree.function} {right}"
    if isinstance(tree, Call):
        return f"{tree.function}({', '.join(map(_text, tree.args))})"
    return tree.name if isinstance(tree, Name) and not tree.subscripts else short_text(tree)
