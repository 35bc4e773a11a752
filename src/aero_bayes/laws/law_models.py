"""Laws as flat models of their own, to be attached to a model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from aero_bayes.files import ScratchFolder
from aero_bayes.laws.class_with_laws import class_text
from aero_bayes.laws.law import Law
from aero_bayes.modelica.flat import FlatEquation, FlatModel
from aero_bayes.modelica.rumoca_front import load_flat
from aero_bayes.modelica.syntax import Expression, Name, map_names

LawModels = Mapping[tuple[str, str], FlatModel]


def law_models(laws: Sequence[Law], sources: Sequence[Path] = ()) -> LawModels:
    """Return each law as a flat model of its own, by kind and id.

    ``sources`` are the packages of the laws, for laws that use functions or types of their package. One run of the
    compiler flattens all."""
    classes: list[str] = []
    components: list[str] = []
    inputs: dict[str, list[str]] = {}
    for law in laws:
        name = f"{law.kind}_{law.id}"
        classes += class_text(law, f"Model_{name}", nominals={}, signals={})
        inputs[name] = [signal for signal in law.interface.inputs if signal in law.used_inputs]
        components.append(f"  Model_{name} {name}({', '.join(f'{signal} = time' for signal in inputs[name])});")
    with ScratchFolder() as folder:
        path = Path(folder) / "LawsAtOnce.mo"
        lines = ["within ;", "model LawsAtOnce", *classes, *components, "end LawsAtOnce;", ""]
        path.write_text("\n".join(lines), encoding="utf-8")
        flat = load_flat("LawsAtOnce", [*sources, path], ())
    own = (component_of(flat, name, given) for name, given in inputs.items())
    return {
        (law.kind, law.id): FlatModel(law.id, p.variables, p.equations, p.initial_equations, functions=p.functions)
        for law, p in zip(laws, own, strict=True)
    }


def component_of(flat: FlatModel, instance: str, inputs: Sequence[str]) -> FlatModel:
    """Return one component of a flat model with what it states itself, but for what its inputs are set to."""
    prefix = f"{instance}."
    given = [Name(prefix + name) for name in inputs]

    def inner(n: Name) -> Expression:
        return Name(n.name.removeprefix(prefix), n.subscripts)

    unconnected = {v.name.rpartition(".")[0] for v in flat.variables if v.flow and v.name.count(".") == 2}

    def own(equations: Sequence[FlatEquation]) -> tuple[FlatEquation, ...]:
        return tuple(
            replace(e, left=map_names(e.left, inner), right=map_names(e.right, inner),
                    component=e.component.removeprefix(prefix) if e.component != instance else "")
            for e in equations
            if (e.component == instance and e.left not in given)
            or (e.component.startswith(prefix) and (e.origin != "flow" or e.component not in unconnected))
        )  # fmt: skip

    variables = tuple(
        replace(v, name=v.name.removeprefix(prefix), binding=None if v.binding is None else map_names(v.binding, inner),
                attributes={k: map_names(t, inner) for k, t in v.attributes.items()})
        for v in flat.variables if v.name.startswith(prefix)
    )  # fmt: skip
    return replace(flat, name=instance, variables=variables, equations=own(flat.equations),
                   initial_equations=own(flat.initial_equations))  # fmt: skip
