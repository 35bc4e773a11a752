"""What a model lets be fitted: why a name cannot be, the values of a choice, and bounds where the user gives none."""

from __future__ import annotations

import math
from contextlib import suppress

from aero_bayes.display import join_names
from aero_bayes.errors import InputError
from aero_bayes.modelica.flat import FlatModel, FlatVariable
from aero_bayes.modelica.rumoca_front import load_flat
from aero_bayes.modelica.syntax import Expression, Number, modelica_text, names_in, short_text
from aero_bayes.simulation.model import Model
from aero_bayes.unknown_names import known_names_hint

#: Default bounds of a parameter: its start over and times this factor.
DEFAULT_BOUND_FACTOR = 1e3
#: A model's lower bound below this share of the start only says that the parameter is positive.
MIN_BOUND_RATIO = 1e-12


def model_bound(bound: float | None, start: float) -> float | None:
    """Return a bound that the model gives; a tiny one (``Modelica.Constants.small``) counts as zero."""
    return 0.0 if bound is not None and abs(bound) < MIN_BOUND_RATIO * abs(start) else bound


def default_bounds(
    start: float, lower: float | None, upper: float | None, nominal: float | None
) -> tuple[float, float]:
    """Return bounds as given; where there is none, far from the start, without a change of sign."""
    low = lower if lower is not None and math.isfinite(lower) else None
    high = upper if upper is not None and math.isfinite(upper) else None
    if start > 0.0 and (low is None or low == 0.0):
        low = start / DEFAULT_BOUND_FACTOR
    if start < 0.0 and (high is None or high == 0.0):
        high = start / DEFAULT_BOUND_FACTOR
    size = abs(start) or abs(nominal or 0.0) or 1.0
    return (
        low if low is not None else start - DEFAULT_BOUND_FACTOR * size,
        high if high is not None else start + (DEFAULT_BOUND_FACTOR - 1.0) * size,
    )


def first_given(*values: float | None) -> float | None:
    return next((value for value in values if value is not None), None)


def no_parameter_text(model: Model, name: str) -> str:
    """Return one line that says why a model has no parameter of this name that can be fitted."""
    known = [v.name for v in model.parameters]
    if model.source is not None:
        with suppress(InputError, RecursionError):
            flat = load_flat(model.source.name, model.source.files, model.source.libraries)
            if reason := _reason(flat, name, known):
                return reason
    elif kind := model.causality_of(name):
        why = {
            "calculatedParameter": ", so it follows from other parameters",
            "fixed local": ", so the model alone sets it: export it as a parameter that may be changed (not final, "
            "protected or evaluated)",
            "constant local": ", so nothing sets it",
        }.get(kind, "")
        return f"{name} is no parameter of {model.path.name} that may be set: its causality in the FMU is {kind}{why}"
    return f"model {model.name} has no parameter {name}{known_names_hint(name, sorted(known))}"


def _reason(flat: FlatModel, name: str, known: list[str]) -> str:
    v = next((v for v in flat.variables if v.name == name and v.constant), None)
    if v is None:
        return ""
    if v.type != "Real":
        return own_value_reason(flat, v) or (
            f"parameter {name} of model {flat.name} is of type {v.type} and cannot be searched: list its values, "
            f"such as values = {listed_choices(flat, v)}, and each is fitted"
        )
    return _computed(flat, v, known)


def own_value_reason(flat: FlatModel, v: FlatVariable) -> str:
    """Return one line that says why a parameter that is not Real cannot be given values; empty if it can."""
    if reason := _computed(flat, v, [p.name for p in flat.variables if p.constant and p.variability == "parameter"]):
        return reason
    told = ""
    if v.variability != "parameter" or v.final or v.protected:
        told = "constant, final or protected: the model alone sets it"
    elif v.sizes or "[" in v.name:
        told = "part of an array; declare a parameter that sets it"
    elif v.type == "String" or (v.type not in ("Integer", "Boolean") and not choices_of(flat, v)):
        told = f"of type {v.type}, which is no number, switch or enumeration"
    return f"parameter {v.name} of model {flat.name} is {told}" if told else ""


def choices_of(flat: FlatModel, v: FlatVariable) -> dict[str, int]:
    """List full names of the literals of a parameter's enumeration, with their ordinals."""
    kind = v.type.rpartition(".")[2]
    own = {name: at for name, at in flat.literals.items() if f".{name}".rpartition(".")[0].endswith(f".{kind}")}
    # The compiler lists a literal by its full name, by shorter ones, and each once more in quotes.
    return {
        name: at for name, at in own.items() if "'" not in name and not any(other.endswith(f".{name}") for other in own)
    }


def listed_choices(flat: FlatModel, v: FlatVariable) -> str:
    """Return a list of values that a parameter may have, as TOML writes it."""
    if v.type == "Boolean":
        return "[true, false]"
    if v.type == "Integer":
        least = v.attributes.get("min")
        low = int(least.value) if isinstance(least, Number) else 1
        return f"[{low}, {low + 1}, {low + 2}]"
    own = choices_of(flat, v)
    return "[" + ", ".join(f'"{name.rpartition(".")[2]}"' for name in sorted(own, key=own.__getitem__)) + "]"


def _computed(flat: FlatModel, v: FlatVariable, known: list[str]) -> str:
    behind = sorted(names_in(v.binding) & set(known)) if v.binding is not None else []
    if v.binding is None or not behind:
        return ""
    return (
        f"parameter {v.name} of model {flat.name} is computed: {v.name} = {expression_text(v.binding)}; "
        f"fit {join_names(behind)} in its place"
    )


def expression_text(tree: Expression) -> str:
    """Return an expression as it is written in Modelica, or else what kind of expression it is."""
    return modelica_text(tree) or short_text(tree)
