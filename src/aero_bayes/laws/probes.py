"""Inputs that are added to a flat model at its ports, where laws may act."""

from __future__ import annotations

from aero_bayes.errors import InputError
from aero_bayes.laws.balance import Port
from aero_bayes.laws.internal_signals import defining_equations
from aero_bayes.modelica.compose import add_input, add_term, replace_uses, separate_elements
from aero_bayes.modelica.flat import FlatModel
from aero_bayes.modelica.syntax import Call, Expression, Name, parse_reference


def with_probe(flat: FlatModel, port: Port, name: str, sign: float) -> FlatModel:
    """Return the model with an input that is added to a balance with a sign, or to a signal where it is used."""
    return _with_term(add_input(flat, name, port.unit, f"Unknown signal at {port.id}"), port, Name(name), sign)


def with_drive(flat: FlatModel, port: Port, term: Expression, neighbour: Port | None) -> FlatModel:
    """Return the model with a term that drives a balance, where a law would oppose, or is added to a signal.

    A motion acts back on its neighbour."""
    if signal := port.signals.get("u"):
        flat = separate_elements(flat, str(signal))
    flat = _with_term(flat, port, term, -1.0)
    return flat if neighbour is None or port.kind != "motion" else _with_term(flat, neighbour, term, 1.0)


def _with_term(flat: FlatModel, port: Port, term: Expression, sign: float) -> FlatModel:
    """Add a term to a signal, to a balance or to its potential; it opposes a change, or drives with ``sign`` -1."""
    if port.defining_equation is not None or port.attachment == "input":
        signal = str(port.signals["u"])
        return replace_uses(flat, signal, Call("+", (parse_reference(signal), term)), defining_equations(flat, port))
    if port.balance is None:
        raise InputError(f"the port {port.id!r} has no balance")
    signed = term if sign > 0.0 else Call("neg", (term,))
    if port.attachment == "series":
        end = f"{port.connectors[1]}.{port.potential}"
        inside = [i for i, e in enumerate(flat.equations) if e.origin != "connection"]
        return replace_uses(flat, end, Call("+", (Name(end), signed)), inside)
    return add_term(flat, port.balance.equation, port.balance.added(signed))
