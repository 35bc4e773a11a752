"""Laws written into the text of a class, each by the way in which it is attached to its port."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from aero_bayes.export.flat import FlatModel
from aero_bayes.language.classes import ClassText
from aero_bayes.language.sources import SourceFile, Sources
from aero_bayes.language.syntax import parse_reference
from aero_bayes.laws.balance_writer import BalanceWriter, class_of, equation_of
from aero_bayes.laws.class_with_laws import ClassWithLaws
from aero_bayes.laws.component_copies import without_indices
from aero_bayes.laws.connection_writer import ConnectionWriter, edits_in_series
from aero_bayes.laws.placed_law import PlacedLaw
from aero_bayes.laws.signal_writer import SignalWriter, component_connections
from aero_bayes.ports import Attachment, alias_structure

#: Laws at outputs are written first, then those at inputs: a law in a balance reads the variables that these declare.
_WRITING_ORDER: Mapping[Attachment, int] = {"output": 0, "input": 1}


def with_laws_written(
    known: Sources, user: tuple[SourceFile, ClassText], flat: FlatModel, placed_laws: Sequence[PlacedLaw], title: str
) -> ClassWithLaws:
    """Return the user's class with laws."""
    structure = alias_structure(flat)
    target = ClassWithLaws(
        known, user, placed_laws, title, inherits=_edits_base_class(known, user[1], flat, placed_laws)
    )
    signals, connections = SignalWriter(target, structure), ConnectionWriter(target, known, structure)
    write: Mapping[str, Callable[[PlacedLaw], None]] = {
        "input": signals.write_at_input,
        "output": signals.write_at_output,
        "signal": signals.write_at_signal,
        "equation": BalanceWriter(target, known, flat, structure).write,
        "node": connections.write_at_node,
        "series": connections.write_in_series,
    }
    for placed in sorted(placed_laws, key=lambda p: _WRITING_ORDER.get(p.port.attachment, 2)):
        write[placed.port.attachment](placed)
    return target


def _edits_base_class(known: Sources, cls: ClassText, flat: FlatModel, placed_laws: Sequence[PlacedLaw]) -> bool:
    """Return whether something that is to be edited stands in a base class of the user's class."""
    own = {c.name for c in cls.components()}
    for placed in placed_laws:
        for port in (placed.port, *([placed.neighbour] if placed.neighbour else ())):
            if port.attachment == "signal" and "." in port.signals["u"]:
                if not component_connections(cls, port.signals["u"]):
                    return True
            elif (
                port.attachment in ("input", "output", "signal") and parse_reference(port.signals["u"]).name not in own
            ):
                return True
            if port.attachment == "equation":
                equation = equation_of(flat, port)
                stated = class_of(known, equation)
                inside = without_indices(equation.component)[0]
                if (inside and inside not in own) or (not inside and stated is not cls):
                    return True
            if port.attachment == "series" and not edits_in_series("", cls, port, ["law"]):
                return True
    return False
