"""What a simulated rig truly is, and what it then does."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from aero_bayes.arrays import FloatArray
from simulated_rigs.laws import LAWS, OUTSIDE, LawKind
from simulated_rigs.rig import Assembly, RigKind, run_linear


@dataclass(frozen=True)
class LawPlace:
    """Where a law acts: an ``input``, ``output``, ``balance`` of a state, or ``coupling`` (its stretch)."""

    kind: str
    name: str


@dataclass(frozen=True)
class LawTruth:
    """A law at a place, its parameters in SI units, and how visible it is.

    ``d`` is the size of what no change of the base parameters can imitate, in units of the noise; NaN if not measured.
    """

    law: str
    place: LawPlace
    parameters: Mapping[str, float]
    d: float = field(default=float("nan"), compare=False)


def law_places(kind: RigKind) -> list[tuple[str, LawPlace]]:
    """List all (law, place) that may be missing from a kind's model."""
    found = []
    for where, laws in kind.laws.items():
        prefix, _, name = where.rpartition(":")
        for law in laws.split():
            sort = {"in": "input", "out": "output"}.get(prefix) or ("coupling" if law == "backlash" else "balance")
            found.append((law, LawPlace(sort, name)))
    return found


def outside_places(kind: RigKind) -> list[tuple[str, LawPlace]]:
    """List all (law, place) outside the library that a kind may have."""
    found = [(law, LawPlace("input", name)) for family, law in OUTSIDE if family == "input" for name in kind.inputs]
    found += [(law, LawPlace("output", name)) for family, law in OUTSIDE if family == "output" for name in kind.outputs]
    return found + [
        (law, LawPlace("balance", name))
        for name, balance in kind.states.items()
        for family, law in OUTSIDE
        if family == balance.family
    ]


def law_kind(kind: RigKind, law: str, place: LawPlace) -> LawKind:
    """Return the formula of a law at a place."""
    family = kind.states[place.name].family if place.kind == "balance" else place.kind
    return {**LAWS, **OUTSIDE}[family, law]


def assembled(kind: RigKind, parameters: Mapping[str, float], laws: Sequence[LawTruth]) -> Assembly:
    """Put a rig together with its laws."""
    assembly = Assembly(kind, parameters)
    for law in laws:
        law_kind(kind, law.law, law.place).install(assembly, law.place.name, law.parameters)
    return assembly


def simulate_rig(
    kind: RigKind,
    parameters: Mapping[str, float],
    laws: Sequence[LawTruth],
    time: FloatArray,
    commands: FloatArray,
    start: Sequence[float],
    relative: float = 1e-9,
) -> tuple[FloatArray, FloatArray]:
    """Simulate outputs, shape (n, outputs), and states, shape (n, states), of a rig without noise.

    ``time`` are even sample times in s, ``start`` the states at the first; ``commands``, shape (n, inputs), hold from
    sample to sample; ``relative`` is the solver's tolerance.
    """
    if kind.linear and not laws:
        return run_linear(kind.plant(parameters), kind.step, commands, start)
    outputs, states = assembled(kind, parameters, laws).run(time, commands, start, relative)
    return outputs, states[:, : len(kind.states)]
