"""Inputs that are added to a flat model at its ports, where laws may act."""

from __future__ import annotations

from aero_bayes.errors import InputError
from aero_bayes.laws.balance import Port
from aero_bayes.laws.internal_signals import defining_equations
from aero_bayes.modelica.compose import add_input, add_term, replace_uses
from aero_bayes.modelica.flat import FlatModel
from aero_bayes.modelica.syntax import Call, Expression, Name, parse_reference


def with_probe(flat: FlatModel, port: Port, name: str, sign: float) -> FlatModel:
    """Return the model with an input that is added to a signal where it is used, or to a balance or its potential.

    There it opposes a change, or drives with ``sign`` -1."""
    flat, term = add_input(flat, name, port.unit, f"Unknown signal at {port.id}"), Name(name)
    if port.defining_equation is not None or port.attachment == "input":
        signal = str(port.signals["u"])
        return replace_uses(flat, signal, Call("+", (parse_reference(signal), term)), defining_equations(flat, port))
    if port.balance is None:
        raise InputError(f"the port {port.id!r} has no balance")
    signed: Expression = term if sign > 0.0 else Call("neg", (term,))
    if port.attachment == "series":
        end = f"{port.connectors[1]}.{port.potential}"
        inside = [i for i, e in enumerate(flat.equations) if e.origin != "connection"]
        return replace_uses(flat, end, Call("+", (Name(end), signed)), inside)
    return add_term(flat, port.balance.equation, port.balance.added(signed))
