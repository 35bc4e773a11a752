"""Laws and probes in a flat model: what is screened before anything is written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from aero_bayes.errors import InputError
from aero_bayes.export.compose import (
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
from aero_bayes.export.flat import FlatModel, FlatVariable
from aero_bayes.export.rumoca_front import load_flat
from aero_bayes.language.syntax import Call, Expression, Name, Number, map_names, parse_reference
from aero_bayes.laws.candidates import Candidate
from aero_bayes.laws.law import Law
from aero_bayes.laws.law_text import class_text
from aero_bayes.laws.use import Use, plain_name, uses_of
from aero_bayes.ports.port import Port, Via, signal_of
from aero_bayes.ports.signals import giving
from aero_bayes.scratch import ScratchFolder

Models = Mapping[tuple[str, str], FlatModel]
#: Which laws are composed after others.
_LATE: Mapping[Via, int] = {"input": 1, "output": 2}


def law_models(laws: Sequence[Law], sources: Sequence[Path] = ()) -> Models:
    """Each law as a flat model of its own, by kind and id; one run of the compiler for all.

    ``sources`` are the packages of the laws, where these use functions or types of their package.
    """
    lines = ["model LawsAtOnce"]
    for law in laws:
        name = _instance(law)
        lines += [f"  {line}" for line in class_text(law, f"Model_{name}", sizes={}, signals={})]
        bound = ", ".join(f"{signal} = time" for signal in law.shape.given if signal in law.uses)
        lines.append(f"  Model_{name} {name}{f'({bound})' if bound else ''};")
    lines.append("end LawsAtOnce;")
    with ScratchFolder() as folder:
        path = Path(folder) / "LawsAtOnce.mo"
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        flat = load_flat("LawsAtOnce", [*sources, path])
    return {(law.kind, law.id): _part(flat, _instance(law), law) for law in laws}


def _instance(law: Law) -> str:
    return f"{law.kind}_{law.id}"


def _part(flat: FlatModel, instance: str, law: Law) -> FlatModel:
    prefix = instance + "."
    given = {prefix + signal for signal in law.shape.given}

    def inner(n: Name) -> Expression:
        return Name(n.name.removeprefix(prefix), n.subscripts)

    return FlatModel(
        law.id,
        tuple(
            replace(
                v,
                name=v.name.removeprefix(prefix),
                attributes={k: map_names(t, inner) for k, t in v.attributes.items()},
                binding=None if v.binding is None else map_names(v.binding, inner),
            )
            for v in flat.variables
            if v.name.startswith(prefix)
        ),
        tuple(
            replace(e, left=map_names(e.left, inner), right=map_names(e.right, inner), component="")
            for e in flat.equations
            if e.component == instance and not (isinstance(e.left, Name) and e.left.name in given)
        ),
        tuple(
            replace(e, left=map_names(e.left, inner), right=map_names(e.right, inner), component="")
            for e in flat.initial_equations
            if e.component == instance
        ),
        functions=flat.functions,
    )


def compose_law(flat: FlatModel, use: Use, models: Models) -> FlatModel:
    """A model with one law at one port, its parameters at the top under the names of ``use``.

    Parameters
    ----------
    flat : FlatModel
    use : Use
        Made for this model by :func:`~aero_bayes.laws.use.use_of`; its port may be of the model before other laws
        were added.
    models : mapping
        From :func:`law_models`.
    """
    port, at = use.port, use.instance
    acts = Name(f"{at}.{use.law.shape.acts}")
    law = models[use.law.kind, use.law.id]
    if port.via in ("input", "output"):
        flat = separate_elements(flat, port.signals["u"])
        flat = replace_uses(flat, port.signals["u"], acts if port.via == "input" else Name(f"{at}.u"))
    if port.given is not None:
        flat = replace_uses(flat, port.signals["u"], acts, giving(flat, port))
    flat = instantiate(flat, law, at)
    known = {v.name for v in law.variables}
    if port.via == "output":
        flat = equate(_moved_start(flat, port.signals["u"], f"{at}.u"), port.signals["u"], acts)
    else:
        given = dict(port.signals)
        if use.law.kind == "exchange" and use.neighbour is not None:
            given = {"h_1": port.signals["h"], "h_2": use.neighbour.signals["h"]}
        for signal in use.law.shape.given:
            if signal in known:
                value = signal_of(given[signal]) if signal in given else Number(use.standing.get(signal, 0.0))
                flat = equate(flat, f"{at}.{signal}", value)
    flat = _with_sizes(flat, at, use.all_sizes)
    for p in use.parameters():
        about = f"{p.description} at {port.id}"
        flat = add_parameter(flat, use.names[p.name], use.value(p), use.unit(p), description=about, **use.limits(p))
        flat = set_parameter(flat, f"{at}.{p.name}", Name(use.names[p.name]))
    if port.entrance is not None:
        flat = _enter(flat, port, acts, 1.0)
    if use.neighbour is not None:
        out = Name(f"{at}.q_2") if use.law.kind == "overflow" else acts
        flat = _enter(flat, use.neighbour, out, -1.0)
    return flat


def _with_sizes(flat: FlatModel, instance: str, sizes: Mapping[str, float]) -> FlatModel:
    """Give sizes their values; they and what is final are constants, nothing to tune."""
    prefix = instance + "."

    def sized(v: FlatVariable) -> FlatVariable:
        name = v.name.removeprefix(prefix)
        if not v.name.startswith(prefix) or not v.constant or not (v.final or name in sizes):
            return v
        binding = Number(sizes[name]) if name in sizes else v.binding
        return replace(v, variability="constant", binding=binding)

    return replace(flat, variables=tuple(map(sized, flat.variables)))


def _enter(flat: FlatModel, port: Port, term: Expression, sign: float) -> FlatModel:
    """Add a term that opposes (or drives, with ``sign`` -1) to the port's balance, or to its potential."""
    if port.entrance is None:
        raise InputError(f"the port {port.id!r} has no balance")
    signed = term if sign > 0.0 else Call("neg", (term,))
    if port.via == "series":
        end = f"{port.connectors[1]}.{port.potential}"
        inside = [i for i, e in enumerate(flat.equations) if e.origin != "connection"]
        return replace_uses(flat, end, Call("+", (Name(end), signed)), inside)
    return add_term(flat, port.entrance.equation, port.entrance.added(signed))


def _moved_start(flat: FlatModel, old: str, new: str) -> FlatModel:
    """Give a start value to what takes an output's place, where that output was a state."""
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


def compose_laws(flat: FlatModel, uses: Sequence[Use], models: Models) -> FlatModel:
    """A model with several laws; at one input or output the last one is the outermost.

    Inputs come late, so that a law in a balance is given what acts there; readings last, so that it is given the
    quantity and not its reading.
    """
    for use in sorted(uses, key=lambda u: _LATE.get(u.port.via, 0)):
        flat = compose_law(flat, use, models)
    return flat


def screening(
    flat: FlatModel, found: Sequence[Candidate], sizes: Mapping[str, Mapping[str, float]], models: Models
) -> tuple[FlatModel, tuple[Use, ...]]:
    """One model that has many laws, all switched off; ``sizes`` by the port's id. The uses are in the order given.

    Laws that need the rate of a reading are the innermost ones there.
    """
    uses = uses_of(found, {v.name for v in flat.variables}, sizes)
    inner_first = sorted(uses, key=lambda u: not u.law.takes_rate)
    return compose_laws(flat, inner_first, models), uses


def probe(flat: FlatModel, ports: Sequence[Port]) -> tuple[FlatModel, dict[str, str]]:
    """The model with an input at every port, zero by default, and the name of that input for each port's id.

    A probe adds to an input or an output; in a balance it drives where a law would oppose.
    """
    names: dict[str, str] = {}
    for port in ports:
        name = f"probe_{plain_name(port.id)}"
        flat = add_input(flat, name, port.unit, f"Unknown signal at {port.id}")
        names[port.id] = name
        signal = port.signals.get("u", "")
        if signal:
            flat = separate_elements(flat, signal)
        if port.via == "input":
            flat = replace_uses(flat, signal, Call("+", (parse_reference(signal), Name(name))))
        elif port.given is not None:
            flat = replace_uses(flat, signal, Call("+", (parse_reference(signal), Name(name))), giving(flat, port))
        elif port.via == "output":
            inner = f"{plain_name(signal)}_without_{name}"
            flat = replace_uses(flat, signal, Name(inner))
            flat = _moved_start(add_variable(flat, inner, port.unit), signal, inner)
            flat = equate(flat, signal, Call("+", (Name(inner), Name(name))))
        else:
            flat = _enter(flat, port, Name(name), -1.0)
            if port.kind == "motion" and port.neighbours:
                flat = _enter(flat, next(p for p in ports if p.id == port.neighbours[0]), Name(name), 1.0)
    return flat, names
