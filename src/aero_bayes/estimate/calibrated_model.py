"""A model with given values: a Modelica class that extends it with those of a fit, and the FMU of that class.

So are models with listed values of parameters that no search can move: whole numbers, switches, enumerations.
Each combination of them is a model of its own, with the values as modifiers where they are not Real.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import date
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.display import join_names, with_unit
from aero_bayes.errors import InputError
from aero_bayes.estimate.calibration import Calibration, values_of_recordings
from aero_bayes.estimate.fittable import (
    choices_of,
    expression_text,
    listed_choices,
    no_parameter_text,
    own_value_reason,
)
from aero_bayes.estimate.parameters import ChosenParameters, ParameterSet, ParameterSpec
from aero_bayes.files import ScratchFolder, write_whole
from aero_bayes.modelica.compilers import export_fmu
from aero_bayes.modelica.compose import set_elements
from aero_bayes.modelica.embedded import export_flat
from aero_bayes.modelica.flat import FlatModel, FlatVariable
from aero_bayes.modelica.parse import without_indices
from aero_bayes.modelica.rumoca_front import load_flat
from aero_bayes.modelica.syntax import Array, Number
from aero_bayes.simulation.interface import ParameterTarget, StartTarget
from aero_bayes.simulation.model import Model, ModelicaSource
from aero_bayes.simulation.probed_facts import start_parameters

if TYPE_CHECKING:
    from aero_bayes.estimate.identifiability import Estimate

#: Values of one element, or of the elements of an array.
ParameterValues = float | str | list["ParameterValues"]
#: Modifications by component: a value and what is said of it, or those inside.
ModifierTree = dict[str, "tuple[str, str] | ModifierTree"]


@dataclass(frozen=True, eq=False)
class CalibratedModel:
    """A Modelica class that gives a model its fitted values."""

    base: ModelicaSource
    parameters: Mapping[str, float | str]
    remarks: Mapping[str, str] = field(default_factory=dict)
    header: tuple[str, ...] = ()
    added: Mapping[str, str] = field(default_factory=dict)
    suffix: str = "fitted"
    stop: float | None = None

    @property
    def name(self) -> str:
        """Name of the class."""
        return f"{self.base.name.rpartition('.')[2]}_{self.suffix}"

    @property
    def text(self) -> str:
        """The Modelica file."""
        lines = [f"  // {line}" for line in self.header]
        modifiers = _modifiers(_tree(self.parameters, self.remarks))
        extends = [f"  extends {self.base.name}(", *(f"    {m}" for m in modifiers), "  );"]
        lines += extends if modifiers else [f"  extends {self.base.name};"]
        if self.stop is not None and self.stop > 0.0:
            lines.append(f"  annotation (experiment(StopTime = {self.stop:.12g}));")
        title = f'model {self.name} "{self.base.name} with the values of a fit"'
        return "\n".join(["within ;", title, *lines, f"end {self.name};", ""])

    def write(self, folder: Path | str) -> Path:
        """Write ``NAME.mo`` to a ``folder``, and beside it the files that were written for it; returns its path."""
        target = Path(folder)
        target.mkdir(parents=True, exist_ok=True)
        for name, text in {**self.added, f"{self.name}.mo": self.text}.items():
            write_whole(target / name, text)
        return target / f"{self.name}.mo"

    def export_fmu(self, path: Path | str) -> Path:
        """Compile the class to the FMU ``path``."""
        with ScratchFolder() as scratch:
            written = self.write(scratch)
            sources = [*self.base.files, *(scratch / name for name in self.added)]
            libraries = self.base.libraries
            try:
                return export_fmu(
                    self.name, Path(path), sources=[*sources, written], libraries=libraries, stop=self.stop
                )
            except InputError:
                numbers = {name: v for name, v in self.parameters.items() if not isinstance(v, str)}
                if len(numbers) < len(self.parameters) or not any("[" in name for name in numbers):
                    raise
            # The embedded compiler cannot give components that are declared with `each` values of their own: they
            # are set after the model has been made flat.
            flat = replace(load_flat(self.base.name, sources, libraries), name=self.name)
            return export_flat(set_elements(flat, numbers), path, stop=self.stop)


def calibrated_model(
    calibration: Calibration,
    values: FloatArray,
    intervals: Mapping[str, Estimate],
    *,
    source: ModelicaSource | None = None,
    added: Mapping[str, str] | None = None,
    chosen: Mapping[str, str] | None = None,
    delays: Collection[str] = (),
) -> CalibratedModel:
    """Return the class with the values (p,) of a calibration's parameters, and those that it holds."""
    model = calibration.model
    base = source or _source_of(model)
    own = list(zip(calibration.parameters, values.tolist(), strict=True))
    fitted = {p.target.name: (p.name, v) for p, v in own if isinstance(p.target, ParameterTarget)}
    fitted |= {p.name: (p.name, v) for p, v in own if p.name in delays}
    units = {v.name: v.unit for v in model.parameters} | {p.name: p.unit for p, _ in own if p.name in delays}
    remarks = {name: "held" for name in calibration.fixed}
    for target, (name, _) in fitted.items():
        remarks[target] = _interval_text(intervals.get(name), units.get(target, ""))
    given = {**calibration.fixed, **{target: value for target, (_, value) in fitted.items()}}
    for target, several in values_of_recordings(calibration.parameters, values.tolist()).items():
        if len(several) > 1:
            given[target] = float(np.mean(list(several.values())))
            remarks[target] = f"mean of {', '.join(f'{name} = {v:.6g}' for name, v in several.items())}"
    for target, starts in _started(calibration, values, given).items():
        given[target] = float(np.mean(starts))
        remarks[target] = "initial value" if len(starts) == 1 else f"mean of {len(starts)} initial values"
    data = ", ".join(r.path.name if r.path is not None else r.name for r in calibration.data.recordings)
    header = [f"Fitted to {data} on {date.today().isoformat()}; beside each value its central 90 % interval."]
    needed = [*(file.name for file in base.files), *(added or {})]
    header += [f"Load {join_names(needed)} first."] if needed else []
    values_given: dict[str, float | str] = {**_whole_arrays(model, base, given), **(chosen or {})}
    told = (*header, *_beside(calibration, values, delays))
    return CalibratedModel(base, values_given, remarks, told, dict(added or {}), stop=calibration.data.stop)


def _source_of(model: Model) -> ModelicaSource:
    """Return what a model was built from; InputError for an FMU whose source is not known."""
    if model.source is None:
        raise InputError(
            f"{model.path.name}: a model with fitted values is compiled from its Modelica source, which is not known "
            "of this FMU; set the values of fit.to_frame() where the FMU is used"
        )
    return model.source


def _started(calibration: Calibration, values: FloatArray, given: Mapping[str, float]) -> dict[str, list[float]]:
    """Return initial values by the parameter of the model that sets them, where the recordings have their own."""
    names = [v.name for v in calibration.model.parameters if v.name not in given]
    found: dict[str, list[float]] = {}
    for name, states in start_parameters(calibration.model, names).items():
        if len(states) == 1:
            estimated = [
                value for p, value in zip(calibration.parameters, values.tolist(), strict=True)
                if p.target == StartTarget(states[0])
            ]  # fmt: skip
            read = [e.start[states[0]] for e in calibration.data.experiments if states[0] in e.start]
            if estimated or read:
                found[name] = estimated or read
    return found


def _beside(calibration: Calibration, values: FloatArray, delays: Collection[str]) -> list[str]:
    """Return what belongs to the recordings and is not written into the model: initial values and delays."""
    lines, estimated = [], set()
    for p, value in zip(calibration.parameters, values.tolist(), strict=True):
        if isinstance(p.target, StartTarget):
            estimated.add(p.target.state)
        if not isinstance(p.target, ParameterTarget) and p.name not in delays:
            lines.append(f"{p.name} = {with_unit(f'{value:.12g}', p.unit)}: {p.description}, not in the model")
    for name, experiment in zip(calibration.data.names, calibration.data.experiments, strict=True):
        held = {state: value for state, value in experiment.start.items() if state not in estimated}
        lines += [f"{state} starts at {value:.12g} in {name}, not in the model" for state, value in held.items()]
    return lines


def _interval_text(found: Estimate | None, unit: str) -> str:
    if found is None or found.q05 is None or found.q95 is None:
        return ", ".join(filter(None, (with_unit("", unit).strip(), "no interval")))
    return with_unit(f"{found.q05:.6g} to {found.q95:.6g}", unit)


def _indices(name: str) -> tuple[int, ...]:
    return tuple(int(n) for n in re.findall(r"\d+", ",".join(re.findall(r"\[([^\]]*)\]", name))))


def _whole_arrays(model: Model, base: ModelicaSource, given: Mapping[str, float]) -> dict[str, float | str]:
    """Return the values, with the model's own for the other elements of an array: Modelica sets an array as a whole.

    An element that the model computes from others is no parameter of it; its expression stands in the source."""
    arrays = {without_indices(name) for name in given if "[" in name}
    own: dict[str, float | str] = {}
    with suppress(InputError):
        for v in load_flat(base.name, base.files, base.libraries).variables if arrays else ():
            if v.name in arrays and isinstance(v.binding, Array):
                own |= {f"{v.name}[{k}]": expression_text(item) for k, item in enumerate(v.binding.items, 1)
                        if not isinstance(item, Array)}  # fmt: skip
    own |= {v.name: v.start for v in model.parameters if v.start is not None and without_indices(v.name) in arrays}
    return {**own, **given}


def _tree(given: Mapping[str, float | str], remarks: Mapping[str, str]) -> ModifierTree:
    """Return values with their remarks, by components as they are nested; an array's elements are one value."""
    # Of an array of components with one value in each, the modifier says `each`: not every compiler spreads an array
    # over components whose declaration has `each` already.
    arrays: dict[tuple[str, ...], dict[tuple[int, ...], float | str]] = {}
    said: dict[tuple[str, ...], list[str]] = {}
    in_components: dict[tuple[str, ...], bool] = {}
    for name, value in given.items():
        path = tuple(without_indices(name).split("."))
        in_components[path] = "[" in name and not name.endswith("]")
        arrays.setdefault(path, {})[_indices(name)] = value
        said.setdefault(path, []).extend([remarks[name]] if name in remarks else [])
    tree: ModifierTree = {}
    for path in sorted(arrays):
        node: Any = tree
        for part in path[:-1]:
            node = node.setdefault(part, {})
        values = arrays[path]
        same = bool(in_components[path]) and len(set(values.values())) == 1
        leaf = f"each {path[-1]}" if same else path[-1]
        text = _text(next(iter(values.values())) if same else _array(values.items()))
        node[leaf] = text, "; ".join(dict.fromkeys(said[path]))
    return tree


def _modifiers(tree: ModifierTree, indent: str = "") -> list[str]:
    """Write the lines of a class modification, a parameter a line."""
    lines = []
    for k, (name, node) in enumerate(tree.items(), 1):
        comma = "," if k < len(tree) else ""
        if isinstance(node, dict):
            lines += [f"{indent}{name}(", *_modifiers(node, f"{indent}  "), f"{indent}){comma}"]
        else:
            value, about = node
            lines.append(f"{indent}{name} = {value}{comma}{f'  // {about}' if about else ''}")
    return lines


def _array(elements: Iterable[tuple[tuple[int, ...], float | str]]) -> ParameterValues:
    """Nest elements in lists by their indices."""
    rows = sorted(elements)
    if rows[0][0] == ():
        return rows[0][1]
    firsts = dict.fromkeys(index[0] for index, _ in rows)
    return [_array((index[1:], value) for index, value in rows if index[0] == first) for first in firsts]


def _text(value: ParameterValues) -> str:
    """Write it with as many digits as give the same trajectory again."""
    if isinstance(value, str):
        return value
    return f"{{{', '.join(map(_text, value))}}}" if isinstance(value, list) else f"{value:.12g}"


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
        if isinstance(spec, ParameterSpec) and spec.values is not None:
            listed[name] = tuple(spec.values)
        elif isinstance(spec, Mapping):
            if set(spec) != {"values"}:
                raise InputError(f'parameters: {name}: expected {{"values": [...]}} or a ParameterSpec, got {spec!r}')
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
