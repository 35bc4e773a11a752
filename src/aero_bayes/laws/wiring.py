"""What laws read and where their outputs go: the coupled FMU and the written text are both printed from this."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from aero_bayes.laws.balance import Attachment, Port, Signal
from aero_bayes.laws.candidates import PlacedLaw


@dataclass(frozen=True)
class Read:
    """An input of a law, and the signal that it is; or what the law ``after`` which it acts makes of that signal.

    A signal is as the equations use it: behind laws at inputs and at signals, before those at outputs. Where it is
    ``raw`` it is before all laws: so for a law at an input, and for what a law on a signal reads besides."""

    input: str
    signal: Signal
    after: PlacedLaw | None = None
    raw: bool = False


@dataclass(frozen=True)
class Added:
    """An output of a law that is added at a port, with ``sign`` 1 where it opposes a change there, else -1."""

    port: Port
    output: str
    sign: int


@dataclass(frozen=True)
class WiredLaw:
    """A law, what it reads, and where it acts: at balances, or on a signal.

    Of laws on one signal, the output of the ``outermost`` one is what others read."""

    law: PlacedLaw
    reads: tuple[Read, ...]
    added: tuple[Added, ...] = ()
    outermost: bool = False

    @property
    def ports(self) -> tuple[Port, ...]:
        """The ports at which it acts."""
        return tuple(added.port for added in self.added) or (self.law.port,)


def wiring(placed_laws: Sequence[PlacedLaw]) -> tuple[WiredLaw, ...]:
    """Wire laws; they stand in the order in which they act: at inputs, inside the model, at outputs.

    Of laws on one signal inside the model, or on an input, the first one placed acts last; on an output the last one.
    """
    found: list[WiredLaw] = []
    latest: dict[tuple[Attachment, Signal], PlacedLaw] = {}
    inward = [p for p in reversed(placed_laws) if p.port.attachment != "output"]
    inward.sort(key=lambda p: p.port.attachment != "input")
    order = [*inward, *(p for p in placed_laws if p.port.attachment == "output")]
    for placed in order:
        if (signal := placed.port.acted_on) is None:
            reads = tuple(Read(name, given) for name, given in _read(placed).items())
            found.append(WiredLaw(placed, reads, _added(placed)))
            continue
        place = placed.port.attachment, signal
        others = (Read(name, given, raw=True) for name, given in placed.port.signals.items() if name != "u")
        own = Read("u", signal, latest.get(place), raw=placed.port.attachment == "input")
        found.append(WiredLaw(placed, (own, *others)))
        latest[place] = placed
    return tuple(replace(w, outermost=any(w.law is placed for placed in latest.values())) for w in found)


def _read(placed: PlacedLaw) -> dict[str, Signal]:
    """Return the signals that the inputs of a law at a balance are."""
    if placed.law.kind == "exchange" and placed.neighbour is not None:
        return {"h_1": placed.port.signals["h"], "h_2": placed.neighbour.signals["h"]}
    return {**placed.port.signals}


def _added(placed: PlacedLaw) -> tuple[Added, ...]:
    """Return the balances to which a law is added: with a sign that opposes a change, and reversed at a neighbour."""
    own = placed.law.interface.output
    if placed.neighbour is None:
        return (Added(placed.port, own, 1),)
    other = "q_2" if placed.law.kind == "overflow" else own
    return Added(placed.port, own, 1), Added(placed.neighbour, other, -1)
