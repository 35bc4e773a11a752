"""Inputs that are added to a flat model at its ports, where laws may act."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from aero_bayes.errors import InputError
from aero_bayes.modelica.compose import add_input, add_term, add_variable, equate, replace_uses, separate_elements
from aero_bayes.modelica.flat import FlatModel
from aero_bayes.modelica.syntax import Call, Expression, Name, parse_reference
from aero_bayes.structure.balance import Port
from aero_bayes.structure.candidates import identifier
from aero_bayes.structure.internal_signals import defining_equations


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
