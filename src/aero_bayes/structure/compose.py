"""Laws and probe inputs added to a flat model, for a search that writes no source."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from aero_bayes.errors import InputError
from aero_bayes.files import ScratchFolder
from aero_bayes.modelica.compose import (
    add_input,
    add_parameter,
    add_term,
    add_variable,
    equate,
    instantiate,
    replace_uses,
    separate_elements,
    set_parameter,
)
from aero_bayes.modelica.flat import FlatEquation, FlatModel, FlatVariable
from aero_bayes.modelica.rumoca_front import load_flat
from aero_bayes.modelica.syntax import Call, Expression, Name, Number, map_names, parse_reference
from aero_bayes.structure.balance import Attachment, Port, signal_expression
from aero_bayes.structure.candidates import PlacedLaw, identifier
from aero_bayes.structure.class_with_laws import class_text
from aero_bayes.structure.internal_signals import defining_equations
from aero_bayes.structure.law import Law

LawModels = Mapping[tuple[str, str], FlatModel]
#: Laws at inputs and then those at outputs are composed after all others.
_COMPOSING_ORDER: Mapping[Attachment, int] = {"input": 1, "output": 2}


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
    found: dict[tuple[str, str], FlatModel] = {}
    for law in laws:
        p = component_of(flat, f"{law.kind}_{law.id}", inputs[f"{law.kind}_{law.id}"])
        found[law.kind, law.id] = FlatModel(
            law.id, p.variables, p.equations, p.initial_equations, functions=p.functions
        )
    return found


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


def compose_law(flat: FlatModel, placed: PlacedLaw, models: LawModels) -> FlatModel:
    """Return a model with one law at one port. The parameters of the law become parameters of the model."""
    port, at = placed.port, placed.instance
    acts = Name(f"{at}.{placed.law.interface.output}")
    law = models[placed.law.kind, placed.law.id]
    if port.attachment in ("input", "output"):
        flat = separate_elements(flat, port.signals["u"])
        flat = replace_uses(flat, port.signals["u"], acts if port.attachment == "input" else Name(f"{at}.u"))
    if port.defining_equation is not None:
        flat = replace_uses(flat, port.signals["u"], acts, defining_equations(flat, port))
    flat = instantiate(flat, law, at)
    known = {v.name for v in law.variables}
    given = dict(port.signals)
    if port.attachment == "output":
        flat = equate(_with_start_moved(flat, port.signals["u"], f"{at}.u"), port.signals["u"], acts)
        known = known - {"u"}
    elif placed.law.kind == "exchange" and placed.neighbour is not None:
        given = {"h_1": port.signals["h"], "h_2": placed.neighbour.signals["h"]}
    for signal in placed.law.interface.inputs:
        if signal in known:
            value = (
                signal_expression(given[signal]) if signal in given else Number(placed.signal_defaults.get(signal, 0.0))
            )
            flat = equate(flat, f"{at}.{signal}", value)
    flat = _with_nominals(flat, at, placed.all_nominals)
    for p in placed.parameters():
        name, about = placed.names[p.name], placed.about(p)
        if not placed.is_twin:
            flat = add_parameter(flat, name, placed.value(p), placed.unit(p), description=about, **placed.limits(p))
        flat = set_parameter(flat, f"{at}.{p.name}", Name(name))
    if port.balance is not None:
        flat = add_to_balance(flat, port, acts, 1.0)
    if placed.neighbour is not None:
        out = Name(f"{at}.q_2") if placed.law.kind == "overflow" else acts
        flat = add_to_balance(flat, placed.neighbour, out, -1.0)
    return flat


def _with_nominals(flat: FlatModel, instance: str, nominals: Mapping[str, float]) -> FlatModel:
    """Set the nominal values of a law. These and its final parameters become constants."""
    prefix = instance + "."

    def sized(v: FlatVariable) -> FlatVariable:
        name = v.name.removeprefix(prefix)
        if not v.name.startswith(prefix) or not v.constant or not (v.final or name in nominals):
            return v
        binding = Number(nominals[name]) if name in nominals else v.binding
        return replace(v, variability="constant", binding=binding)

    return replace(flat, variables=tuple(map(sized, flat.variables)))


def add_to_balance(flat: FlatModel, port: Port, term: Expression, sign: float) -> FlatModel:
    """Add a term to the balance of a port, or to its potential; it opposes a change, or drives it with ``sign`` -1."""
    if port.balance is None:
        raise InputError(f"the port {port.id!r} has no balance")
    signed = term if sign > 0.0 else Call("neg", (term,))
    if port.attachment == "series":
        end = f"{port.connectors[1]}.{port.potential}"
        inside = [i for i, e in enumerate(flat.equations) if e.origin != "connection"]
        return replace_uses(flat, end, Call("+", (Name(end), signed)), inside)
    return add_term(flat, port.balance.equation, port.balance.added(signed))


def _with_start_moved(flat: FlatModel, old: str, new: str) -> FlatModel:
    """Move the start value of an output that was a state to the variable that takes its place."""
    if parse_reference(old).subscripts:
        return flat
    attributes = flat.variable(old).attributes
    variables = tuple(
        replace(v, attributes={**v.attributes, **attributes}) if v.name == new
        else replace(v, attributes={k: t for k, t in attributes.items() if k != "fixed"}) if v.name == old
        else v
        for v in flat.variables
    )  # fmt: skip
    return replace(flat, variables=variables)


def compose_laws(flat: FlatModel, placed_laws: Sequence[PlacedLaw], models: LawModels) -> FlatModel:
    """Return a model with several laws. At one input or output, the last one is the outermost.

    Laws at inputs come late, so that a law in a balance reads the input that acts there. Laws at outputs come last, so
    that a law in a balance reads the quantity and not its reading."""
    for placed in sorted(placed_laws, key=lambda u: _COMPOSING_ORDER.get(u.port.attachment, 0)):
        flat = compose_law(flat, placed, models)
    return flat


def with_probes(flat: FlatModel, ports: Sequence[Port]) -> tuple[FlatModel, dict[str, str]]:
    """Return the model with a probe input at every port, zero by default, and the name of each by the id of its port.

    A probe is added to an input or an output. In a balance it drives, where a law would oppose."""
    names: dict[str, str] = {}
    for port in ports:
        name = names[port.id] = f"probe_{identifier(port.id)}"
        signal = port.signals.get("u", "")
        if signal:
            flat = separate_elements(flat, signal)
        if port.attachment == "output":
            flat = add_input(flat, name, port.unit, f"Unknown signal at {port.id}")
            inner = f"{identifier(signal)}_without_{name}"
            flat = replace_uses(flat, signal, Name(inner))
            flat = _with_start_moved(add_variable(flat, inner, port.unit), signal, inner)
            flat = equate(flat, signal, Call("+", (Name(inner), Name(name))))
            continue
        flat = with_probe(flat, port, name, -1.0)
        if port.balance is not None and port.kind == "motion" and port.neighbours:
            flat = add_to_balance(flat, next(p for p in ports if p.id == port.neighbours[0]), Name(name), 1.0)
    return flat, names


def with_probe(flat: FlatModel, port: Port, name: str, sign: float) -> FlatModel:
    """Return the model with a probe input that is added to a balance with a sign, or to a signal where it is used."""
    flat = add_input(flat, name, port.unit, f"Unknown signal at {port.id}")
    if port.defining_equation is None and port.attachment != "input":
        return add_to_balance(flat, port, Name(name), sign)
    signal = port.signals["u"]
    kept = defining_equations(flat, port) if port.defining_equation is not None else ()
    return replace_uses(flat, signal, Call("+", (parse_reference(signal), Name(name))), kept)
