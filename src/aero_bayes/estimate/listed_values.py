"""Parameters with a list of values: whole numbers, switches and choices of an enumeration, which no search can move.

Each combination of the values is a model of its own, with the values as modifiers where they are not Real.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path

from aero_bayes.errors import InputError
from aero_bayes.estimate.calibrated_model import CalibratedModel
from aero_bayes.estimate.fittable import choices_of, listed_choices, no_parameter_text, own_value_reason
from aero_bayes.estimate.parameters import ChosenParameters, Override, ParameterSet
from aero_bayes.files import ScratchFolder
from aero_bayes.modelica.flat import FlatModel, FlatVariable
from aero_bayes.modelica.rumoca_front import load_flat
from aero_bayes.modelica.syntax import Number
from aero_bayes.simulation.model import Model

#: A value as the user gives it: a number, true or false, or the name of an enumeration literal.
ListedValue = bool | int | float | str
#: Most combinations that are fitted: each is a whole fit, so that more take hours.
MAX_COMBINATIONS = 24


@dataclass(frozen=True)
class ValueCombination:
    """One value of each listed parameter, and the model that has them.

    ``fixed`` are values of Real parameters, ``modifiers`` the others as Modelica writes them, ``numbers`` all of them
    as the compiled model has them (a literal by its place in its enumeration)."""

    model: Model
    values: Mapping[str, ListedValue] = field(default_factory=dict)
    numbers: Mapping[str, float] = field(default_factory=dict)
    fixed: Mapping[str, float] = field(default_factory=dict)
    modifiers: Mapping[str, str] = field(default_factory=dict)

    @property
    def text(self) -> str:
        return values_text(self.values)


@dataclass(frozen=True)
class _Choice:
    """A value, its number, and what Modelica writes for it; no text for a Real parameter."""

    value: ListedValue
    number: float
    text: str = ""


def split_values(
    chosen: ChosenParameters,
) -> tuple[ChosenParameters, dict[str, tuple[ListedValue, ...]]]:
    """Split parameters to search from those whose values are listed, with these values."""
    if isinstance(chosen, ParameterSet) or not isinstance(chosen, Mapping):
        return chosen, {}
    listed = {}
    for name, spec in chosen.items():
        if isinstance(spec, Override) and spec.values is not None:
            listed[name] = tuple(spec.values)
        elif isinstance(spec, Mapping):
            if set(spec) != {"values"}:
                raise InputError(f'parameters: {name}: expected {{"values": [...]}} or an Override, got {spec!r}')
            listed[name] = tuple(spec["values"])
    return {name: spec for name, spec in chosen.items() if name not in listed}, listed


def values_text(values: Mapping[str, ListedValue]) -> str:
    """Return values by name, as they are given."""
    return ", ".join(f"{name} = {value_text(value)}" for name, value in values.items())


def value_text(value: ListedValue) -> str:
    """Return a value as TOML and Modelica write it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    return value if isinstance(value, str) else f"{value:.12g}"


def combinations(model: Model, values: Mapping[str, Sequence[ListedValue]]) -> list[ValueCombination]:
    """Return every combination of listed values, not compiled yet: :func:`compiled` gives its model the values."""
    if not values:
        return [ValueCombination(model)]
    count = math.prod(len(given) for given in values.values())
    if not 0 < count <= MAX_COMBINATIONS:
        raise InputError(
            f"{', '.join(values)}: {count} combinations of values are given; expected 1 to {MAX_COMBINATIONS}, since "
            "each is a fit of its own"
        )
    real = {v.name for v in model.parameters}
    flat = _flat(model, [name for name in values if name not in real])
    choices = [
        [_real(name, v) for v in given] if name in real else _discrete(model, flat, name, given)
        for name, given in values.items()
    ]
    found = []
    for chosen in product(*choices):
        own = dict(zip(values, chosen, strict=True))
        found.append(
            ValueCombination(
                model,
                {name: c.value for name, c in own.items()},
                {name: c.number for name, c in own.items()},
                {name: c.number for name, c in own.items() if not c.text},
                {name: c.text for name, c in own.items() if c.text},
            )
        )
    return found


def compiled(combination: ValueCombination) -> ValueCombination:
    """Return the combination with its own model, built from the class with its modifiers where it has any."""
    model = combination.model
    if not combination.modifiers or model.source is None:
        return combination
    with ScratchFolder() as scratch:
        try:
            path = CalibratedModel(model.source, dict(combination.modifiers)).export_fmu(scratch / "values.fmu")
        except InputError as error:
            raise InputError(f"{combination.text}: {error}") from None
        kept = _kept(path)
    built = replace(Model.load(kept), name=model.name, source=model.source, declared=model.declared)
    return replace(combination, model=built)


def _kept(path: Path) -> Path:
    """Return the file where it stays until this process ends."""
    from aero_bayes.simulation.load_model import session_folder

    return path.rename(session_folder() / path.name)


def _flat(model: Model, names: Sequence[str]) -> FlatModel | None:
    if not names:
        return None
    if model.source is None:
        raise InputError(
            f"model {model.name} has no Real parameter {names[0]}; values of other types are set in Modelica source: "
            "give the class in place of the FMU"
        )
    return load_flat(model.source.name, model.source.files, model.source.libraries)


def _real(name: str, value: ListedValue) -> _Choice:
    if isinstance(value, bool | str) or not math.isfinite(value):
        raise InputError(f"{name}: value {value_text(value)} is no number, and the parameter is Real")
    return _Choice(float(value), float(value))


def _discrete(model: Model, flat: FlatModel | None, name: str, given: Sequence[ListedValue]) -> list[_Choice]:
    """Return the values of a parameter that is Integer, Boolean or of an enumeration."""
    v = next((v for v in flat.variables if v.name == name and v.constant), None) if flat is not None else None
    if v is None or flat is None:
        raise InputError(no_parameter_text(model, name))
    if reason := own_value_reason(flat, v):
        raise InputError(reason)
    found = [choice for value in given if (choice := _choice(flat, v, value)) is not None]
    if len(found) < len(given):
        bad = next(value for value in given if _choice(flat, v, value) is None)
        raise InputError(
            f"{name}: value {value_text(bad)} cannot be one of the parameter, which is {_kind(flat, v)}; expected "
            f"values such as {listed_choices(flat, v)}"
        )
    return found


def _kind(flat: FlatModel, v: FlatVariable) -> str:
    limits = [f"{what} {t.value:g}" for what in ("min", "max") if isinstance(t := v.attributes.get(what), Number)]
    return " with ".join([f"of type {v.type}", *([" and ".join(limits)] if limits and v.type == "Integer" else [])])


def _choice(flat: FlatModel, v: FlatVariable, value: ListedValue) -> _Choice | None:
    """Return a value of the type that the parameter has; None if it is none."""
    if v.type == "Boolean":
        return _Choice(value, float(value), value_text(value)) if isinstance(value, bool) else None
    if v.type == "Integer":
        if isinstance(value, bool | str) or value != int(value):
            return None
        low, high = v.attributes.get("min"), v.attributes.get("max")
        outside = (isinstance(low, Number) and value < low.value) or (isinstance(high, Number) and value > high.value)
        return None if outside else _Choice(int(value), float(value), str(int(value)))
    literals = choices_of(flat, v)
    full = [key for key in literals if isinstance(value, str) and f".{key}".endswith(f".{value}")]
    return _Choice(value, float(literals[full[0]]), full[0]) if full else None
