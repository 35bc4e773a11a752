"""Laws written as components at connections: as an element at a node, or in series."""

from __future__ import annotations

from collections.abc import Sequence

from aero_bayes.errors import InputError
from aero_bayes.language.classes import ClassText
from aero_bayes.language.edits import TextEdit, insert_before_connector
from aero_bayes.language.sources import Sources
from aero_bayes.laws.class_with_laws import ClassWithLaws
from aero_bayes.laws.placed_law import PlacedLaw
from aero_bayes.ports import DIFFERENCE, AliasStructure, Port


class ConnectionWriter:
    """Writes laws at connections."""

    def __init__(self, target: ClassWithLaws, known: Sources, structure: AliasStructure) -> None:
        self.target, self.known, self.structure = target, known, structure

    def write_at_node(self, placed: PlacedLaw) -> None:
        port, exchange = placed.port, placed.law.kind == "exchange"
        ends = {"port": port.connectors[0]}
        acts = placed.law.interface.output
        flows = [f"port.{port.flow} = {acts};"]
        inside = self._inside(port)
        if placed.neighbour is not None:
            ends["neighbour"] = placed.neighbour.connectors[0]
            taken = "q_2" if placed.law.kind == "overflow" else placed.law.interface.output
            flows.append(f"neighbour.{placed.neighbour.flow} = -{taken};")
        if exchange:
            inside = {"h_1": f"port.{port.potential}", "h_2": f"neighbour.{port.potential}"}
        elif placed.neighbour is not None and port.kind == "motion":
            other = {k: v.replace("port.", "neighbour.") for k, v in self._inside(placed.neighbour).items()}
            inside = {k: f"{v}{DIFFERENCE}{other[k]}" for k, v in inside.items() if k in other}
        given = {k: v for k, v in port.signals.items() if k not in inside}
        self.target.declare(placed, given, inside, self._connectors(port, *ends), flows)
        self.target.equations += [f"connect({placed.instance}.{end}, {outer});" for end, outer in ends.items()]

    def _inside(self, port: Port) -> dict[str, str]:
        """Return what a law's class can take from its own connector: the potential, or its rate."""
        potential = f"port.{port.potential}"
        if port.kind == "storage":
            return {"h": potential}
        position = port.signals.get("x", "").partition(DIFFERENCE)[0]
        if self.structure.of(f"{port.connectors[0]}.{port.potential}") == self.structure.of(position):
            return {"v": f"der({potential})", "x": potential}
        return {"v": potential}

    def _connectors(self, port: Port, *names: str) -> list[str]:
        """Return declarations of connectors of the port's kind in a law's class."""
        place = self.structure.variables[f"{port.connectors[0]}.{port.flow}"].place
        if place is None:
            raise InputError(f"{port.id}: the class of its connector is not known")
        file, cls, _ = self.known.at(place)
        if not file.text[cls.start :].startswith("partial"):
            return [f"{cls.full_name} {name};" for name in names]
        whole = ["connector End", f"  extends {cls.full_name};", "end End;"]
        return [*whole, *(f"End {name};" for name in names)]

    def write_in_series(self, placed: PlacedLaw) -> None:
        port = placed.port
        left, right = port.connectors
        acts = placed.law.interface.output
        equations = [f"p.{port.potential} - n.{port.potential} = {acts};", f"p.{port.flow} + n.{port.flow} = 0;"]
        given = {} if "i" in placed.law.interface.inputs else dict(port.signals)
        self.target.declare(placed, given, {"i": f"p.{port.flow}"}, self._connectors(port, "p", "n"), equations)
        mine = [
            u.instance
            for u in self.target.placed_laws
            if u.port.attachment == "series" and u.port.connectors[1] == right
        ]
        if placed.instance != mine[0]:
            return
        edits = edits_in_series(self.target.file.text, self.target.cls, port, mine)
        if not edits:
            raise InputError(f"{self.target.cls.full_name}: no connection of {left} and {right} stands in the class")
        self.target.edits += edits


def edits_in_series(text: str, cls: ClassText, port: Port, chain: Sequence[str]) -> list[TextEdit]:
    """Return edits that put a chain of components before the second connector of a port; empty without a connection."""
    return insert_before_connector(text, cls.equations, port.connectors[1], [(f"{c}.p", f"{c}.n") for c in chain])
