"""Places at which formulas may act: balances, connections, inputs, outputs, and parameters of the model itself."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

from aero_bayes.export.flat import FlatModel
from aero_bayes.language.syntax import names_in
from aero_bayes.laws.placed_law import PlacedLaw
from aero_bayes.ports import DIFFERENCE, Port

#: Nominal values of the state and of the largest term of a balance, by the kind of its port.
STATE_AND_TERM = {"storage": ("h_n", "q_n"), "motion": ("v_n", "f_n"), "electrical": ("i_n", "v_n")}


@dataclass(frozen=True)
class FormulaPlace:
    """A place at which a formula may act."""

    port: str
    signals: tuple[str, ...]
    own: str = ""
    parameter: str = ""
    order: int = 0


@dataclass(frozen=True)
class FormulaPort:
    """A port at which a formula may act."""

    port: Port
    size: float
    neighbour: Port | None = None
    parameter: bool = False

    @property
    def at_signal(self) -> bool:
        """Whether a formula changes a signal; else it is a term of a balance."""
        return "u" in self.port.signals

    @property
    def order(self) -> int:
        """Balances come first, then inputs, outputs, parameters: what is the same at several is told at the first."""
        return 3 if self.parameter else {"input": 1, "signal": 1, "output": 2}.get(self.port.attachment, 0)


def formula_ports(placed_laws: Collection[PlacedLaw]) -> list[FormulaPort]:
    """Return the ports at which laws were placed and formulas may be, too.

    A motion relative to an input has the balance of the port of the motion itself, whose formulas may read the input.
    """
    found = []
    for p in {p.port.id: p for p in placed_laws}.values():
        port = p.port
        relative = any(DIFFERENCE in given for given in port.signals.values())
        if port.replaceable is not None or (relative and not port.neighbours):
            continue
        name = "u_n" if "u" in port.signals else STATE_AND_TERM.get(port.kind, ("", ""))[1]
        if name:
            neighbour = p.neighbour if port.kind == "motion" else None
            found.append(FormulaPort(port, p.nominals.get(name, 1.0), neighbour))
    return found


def parameter_ports(flat: FlatModel, free: Collection[str]) -> Iterator[FormulaPort]:
    """Yield parameters of the model itself that equations use, and no declaration of anything else.

    A parameter of a component has its equations in a class that others share, and is none of them."""
    declared = {
        n for v in flat.variables for tree in (v.binding, *v.attributes.values()) if tree is not None
        for n in names_in(tree)
    }  # fmt: skip
    for v in flat.variables:
        plain = v.variability == "parameter" and v.type == "Real" and not v.sizes and not v.final and "." not in v.name
        if plain and v.name in free and v.name not in declared:
            units = {"u": v.unit, "y": v.unit}
            port = Port(v.name, "input", "input", v.unit, units, v.place, (), {"u": v.name})
            yield FormulaPort(port, 1.0, parameter=True)


def near_signals(
    place: FormulaPort, own: Sequence[str], states: Sequence[str], inputs: Sequence[str]
) -> tuple[str, ...]:
    """Return signals by their nearness to a place: its own ones, then inputs before states at a signal."""
    far = (*inputs, *states) if place.at_signal else (*place.port.states, *inputs, *states)
    return tuple(dict.fromkeys((*own, *far)))
