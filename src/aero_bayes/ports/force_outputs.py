"""Ports at forces, torques and voltages that are outputs: each is the sum of what resists a motion or a current."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace

from aero_bayes.export.flat import FlatEquation, FlatVariable
from aero_bayes.language.dimensions import Dimension, dimension_of_unit
from aero_bayes.language.syntax import Call, Expression, Name, names_in, walk
from aero_bayes.ports.aliases import AliasStructure
from aero_bayes.ports.balance import find_balance, parameter_values
from aero_bayes.ports.insertion_point import Driver, sign_of_factor
from aero_bayes.ports.port import DIFFERENCE, Port, PortKind
from aero_bayes.ports.quantities import unit_in

#: Dimensions of a force, a torque and a voltage, each with the signals on which it depends; the first must be there.
_RESISTING: tuple[tuple[PortKind, str, Dimension, Mapping[str, Dimension]], ...] = (
    ("motion", "f", {"kg": 1.0, "m": 1.0, "s": -2.0}, {"v": {"m": 1.0, "s": -1.0}, "x": {"m": 1.0}}),
    ("motion", "f", {"kg": 1.0, "m": 2.0, "s": -2.0}, {"v": {"rad": 1.0, "s": -1.0}, "x": {"rad": 1.0}}),
    ("electrical", "v", dimension_of_unit("V") or {}, {"i": {"A": 1.0}}),
)


def force_outputs(s: AliasStructure, taken: Collection[int]) -> Iterator[Port]:
    """Yield ports at outputs that are forces or torques and depend on one speed, or voltages and on one current.

    A law there is added to the force with the sign of what resists the speed, to the voltage with that of a resistance.
    """
    values = parameter_values(s.flat)
    units = {v.name: v.unit for v in s.flat.variables}
    for v in s.flat.variables:
        if v.causality != "output" or "." in v.name or v.type != "Real" or v.sizes or v.constant:
            continue
        resisting = next((r for r in _RESISTING if dimension_of_unit(v.unit) == r[2]), None)
        given = None if resisting is None else _given_by(s, v, taken)
        if resisting is None or given is None:
            continue
        kind, acts, _, wanted = resisting
        index, whole = given
        signals = {signal: name for signal, of in wanted.items() if (name := _one_signal(s, whole, of))}
        moving = signals.get(next(iter(wanted)), "")
        balance = find_balance(s.flat, index, _is_name(v.name), values, units)
        if not moving or balance is None:
            continue
        if _sign_of_speed(whole, moving, values) > 0:
            balance = replace(balance, scale=Call("neg", (balance.scale,)), sign=-1)
        known = {signal: unit_in(s, s.of(name.partition(DIFFERENCE)[0])) for signal, name in signals.items()}
        yield Port(
            v.name, kind, "equation", v.unit, {**known, acts: v.unit}, s.flat.equations[index].place,
            tuple(s.states_in(whole)), signals, replace(balance, equation=s.origins[index][0], force=v.name),
        )  # fmt: skip


def _given_by(s: AliasStructure, v: FlatVariable, taken: Collection[int]) -> tuple[int, Expression] | None:
    """Return the equation of the model's own class that gives an output explicitly, and what it gives."""
    for index, e in enumerate(s.flat.equations):
        equation, row, _ = s.origins[index]
        own = not e.component and e.origin in ("component", "binding") and not row
        if own and index not in s.plain and equation not in taken:
            for one, whole in _ways(e):
                if (
                    isinstance(one, Name)
                    and one.name == v.name
                    and not one.subscripts
                    and v.name not in names_in(whole)
                ):
                    return index, whole
    return None


def _ways(e: FlatEquation) -> tuple[tuple[Expression, Expression], ...]:
    return (e.left, e.right), (e.right, e.left)


def _is_name(name: str) -> Driver:
    return lambda tree: isinstance(tree, Name) and tree.name == name and not tree.subscripts


def _one_signal(s: AliasStructure, tree: Expression, wanted: Dimension) -> str:
    """Find the only difference of two variables of a dimension in an expression, else the only variable or input.

    Empty if there is none, or more than one."""

    def fits(t: Expression) -> bool:
        known = isinstance(t, Name) and not t.subscripts and t.name in s.same
        return known and isinstance(t, Name) and dimension_of_unit(unit_in(s, s.of(t.name))) == wanted

    differences = {
        f"{a.name}{DIFFERENCE}{b.name}"
        for t in walk(tree)
        if isinstance(t, Call) and t.function == "-" and len(t.args) == 2
        for a, b in [t.args]
        if isinstance(a, Name) and isinstance(b, Name) and fits(a) and fits(b)
    }
    single = {t.name for t in walk(tree) if isinstance(t, Name) and fits(t)}
    inputs = {v.name for v in s.flat.variables if v.causality == "input" and "." not in v.name and fits(Name(v.name))}
    found = differences or single or inputs
    return next(iter(found)) if len(found) == 1 else ""


def _sign_of_speed(whole: Expression, speed: str, values: Mapping[str, float]) -> int:
    """Return the sign with which a speed or current enters an output: positive where it is no factor of a term."""
    return sign_of_factor(whole, _is_name(speed.partition(DIFFERENCE)[0]), values) or 1
