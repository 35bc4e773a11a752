"""Replaceable models as open ports: classes in their place that hold probes, and laws of that place as FMUs.

A law reads the potentials of the connectors of its place, the flow into the first one of two in series, and what is
handed to it. It gives the flows out of the others, what is added to the potential and lost of the flow in series, and
what is added to a signal: all zero in the neutral class."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from aero_bayes.files import ScratchFolder
from aero_bayes.modelica.compose import add_input, add_output, equate
from aero_bayes.modelica.flat import FlatEquation, FlatModel, FlatVariable
from aero_bayes.modelica.rumoca_front import load_flat
from aero_bayes.modelica.syntax import Call, Expression, Name, map_names
from aero_bayes.structure.balance import CombinationRule, ReplaceableModel
from aero_bayes.structure.compose import component_of
from aero_bayes.structure.law import Law
from aero_bayes.structure.placed_law import identifier

ACROSS, LOST, THROUGH = "across", "lost", "through"


@dataclass(frozen=True)
class Terminals:
    """What a law of a replaceable model reads and gives, by the names that it has in the law's FMU."""

    reads: Mapping[str, str]
    passed: Mapping[str, tuple[str, float]]
    definitions: Mapping[str, Expression]

    def reads_in(self, component: str) -> dict[str, str]:
        """Return what a law reads, by the names in the whole model."""
        return {name: f"{component}.{member}" for name, member in self.reads.items()}


def terminals(join: CombinationRule, members: Sequence[FlatVariable]) -> Terminals:
    """Return the terminals of a place from its variables, named from within."""
    reads: dict[str, str] = {}
    passed: dict[str, tuple[str, float]] = {}
    definitions: dict[str, Expression] = {}

    def ends(connector: str) -> tuple[str, str]:
        own = [v for v in members if v.name.rpartition(".")[0] == connector]
        return next(v.name for v in own if not v.flow), next(v.name for v in own if v.flow)

    for connector in join.shared:
        potential, flow = ends(connector)
        reads[identifier(potential)] = potential
        definitions[identifier(flow)] = Name(flow)
    if join.series:
        (potential, flow), (end, out) = map(ends, join.series)
        reads |= {identifier(potential): potential, identifier(flow): flow}
        definitions[ACROSS] = Call("-", (Name(end), Name(potential)))
        definitions[LOST] = Call("+", (Name(flow), Name(out)))
        passed |= {potential: (ACROSS, 1.0), flow: (LOST, -1.0)}
    if join.signal:
        signal, out = join.signal
        reads[signal] = signal
        definitions[THROUGH] = Call("-", (Name(out), Name(signal)))
        passed[signal] = (THROUGH, 1.0)
    constant = {v.name for v in members if v.constant}
    reads |= {name: name for name in join.handed if name not in constant}
    return Terminals(reads, passed, definitions)


def open_replaceables(
    flat: FlatModel, places: Sequence[ReplaceableModel]
) -> tuple[FlatModel, dict[str, str], dict[str, Terminals]]:
    """Return a model with probe inputs in place of what its neutral classes state, their names by
    ``component.terminal``, and the terminals of each component.

    A replaceable model whose neutral class states something else stays as it is."""
    names: dict[str, str] = {}
    opened: dict[str, Terminals] = {}
    for join, components in ((place.combination, place.components) for place in places):
        for component in components if join is not None else ():
            assert join is not None
            found = terminals(join, members(flat, component))
            neutral = [i for i, e in enumerate(flat.equations) if e.component == component and e.origin == "component"]
            if len(neutral) != len(found.definitions):
                continue
            opened[component] = found
            equations = list(flat.equations)
            for i, (terminal, tree) in zip(neutral, found.definitions.items(), strict=True):
                names[f"{component}.{terminal}"] = probe = f"probe_{identifier(component)}_{terminal}"
                whole = map_names(tree, lambda n, at=component: Name(f"{at}.{n.name}", n.subscripts))  # type: ignore[misc]
                equations[i] = FlatEquation(whole, Name(probe), "added", place=equations[i].place)
                flat = add_input(flat, probe)
            flat = replace(flat, equations=tuple(equations))
    return flat, names, opened


def members(flat: FlatModel, component: str) -> list[FlatVariable]:
    """Return the variables of a component, named from within."""
    prefix = f"{component}."
    return [replace(v, name=v.name.removeprefix(prefix)) for v in flat.variables if v.name.startswith(prefix)]


def effect_models(
    laws: Sequence[Law], inputs: Mapping[str, Sequence[str]], sources: Sequence[Path], libraries: Sequence[Path]
) -> dict[str, FlatModel]:
    """Return laws of replaceable models as flat models by themselves, by id. One run of the compiler flattens all.

    ``inputs`` has the names of inputs by the constraining class."""
    title = "EffectsAtOnce"
    lines = ["within ;", f"model {title}"]
    for law in laws:
        bound = ", ".join(f"{name} = time" for name in inputs[law.constraint])
        lines.append(f"  {law.model} {law.id}{f'({bound})' if bound else ''};")
    with ScratchFolder() as folder:
        path = Path(folder) / f"{title}.mo"
        path.write_text("\n".join([*lines, f"end {title};", ""]), encoding="utf-8")
        flat = load_flat(title, (*sources, path), libraries)
    return {law.id: component_of(flat, law.id, inputs[law.constraint]) for law in laws}


def effect_block(flat: FlatModel, join: CombinationRule) -> FlatModel:
    """Return a law of a replaceable model with its terminals as inputs and outputs."""
    found = terminals(join, flat.variables)
    shown = [v.name for v in flat.variables if v.causality == "output"]
    flat = replace(
        flat, variables=tuple(replace(v, causality="local") if v.name in shown else v for v in flat.variables)
    )
    for name, member in found.reads.items():
        if name != member:
            flat = equate(add_input(flat, name), member, Name(name))
    for name, tree in found.definitions.items():
        flat = add_output(flat, name, tree)
    return flat
