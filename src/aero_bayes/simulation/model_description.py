"""The model description of an FMU as plain typed values, whichever version of FMI it is written in."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, get_args

from aero_bayes.errors import InputError
from aero_bayes.modelica.build import this_machine
from aero_bayes.simulation import archive

BINARY_FOLDERS = {version: f"binaries/{folder}" for version, folder in this_machine().folders.items()}

Kind = Literal["real", "integer", "boolean", "enumeration"]
Interface = Literal["model exchange", "co-simulation", "python"]

# OpenModelica's name of the state behind an output that is a state.
_OUTPUT_ALIAS = re.compile(r"(?:\$|_D_)outputAlias_(?P<output>.+)")


@dataclass(frozen=True)
class Variable:
    """A scalar of the model, in SI units as declared.

    ``kind`` is ``real`` for everything but discrete inputs and outputs (``enumeration`` in FMI 3.0 only), ``items`` has
    the names of an enumeration's values; ``settable_start`` tells whether the start value may be set before
    initialisation, ``discrete`` whether the value may change at events only."""

    name: str
    unit: str
    description: str
    start: float | None
    minimum: float | None
    maximum: float | None
    nominal: float | None
    value_reference: int
    kind: Kind = "real"
    settable_start: bool = False
    discrete: bool = False
    items: tuple[tuple[str, float], ...] = ()


#: What an FMU of our own exporter says wrote it. It asks to be called after steps for importers only that move inputs
#: without an event; the engines make one of each jump.
OWN_EXPORTER = "aero-bayes"


#: How a law remembers its input. The parameters of a rate limit are the inverse of the rate and where it starts, beyond
#: the input; those of a play its share, half its width, and that start. A delay, of a reading, has its time alone.
Memory = Literal["", "rate_limit", "play", "delay"]
MEMORIES: tuple[Memory, ...] = get_args(Memory)


def memory_named(text: str) -> Memory:
    """Return the kind of memory of this name; InputError with those there are otherwise."""
    found = next((kind for kind in MEMORIES if kind == text), None)
    if found is None:
        raise InputError(f"there is no memory {text!r} of a law; there are {', '.join(MEMORIES[1:])}")
    return found


@dataclass(frozen=True)
class DescribedOperator:
    """Laws that act on an input and may be applied to its signal beforehand, or on an output and to its samples.

    ``parameters`` are those that they have, ``raw`` is the value reference of what those at an output act on. One law
    at an input may remember it, as a rate limit or a play does (``memory``); the first one at an output that is a state
    may delay it, by the first parameter. ``states`` are those of this law, by position."""

    signal: str
    parameters: tuple[str, ...]
    raw: int | None = None
    memory: Memory = ""
    states: tuple[int, ...] = ()


@dataclass(frozen=True)
class DescribedRelay:
    """A law that steps by the sign of a speed and may be held on a side, by value references of its inputs for that.

    ``speed`` are positions of states with factors, whose sum the speed is."""

    held: int
    direction: int
    speed: tuple[tuple[int, float], ...]


@dataclass(frozen=True)
class ModelDescription:
    """An FMU on disk and what its modelDescription.xml says. The fields are those of :class:`Model`."""

    path: Path
    sha256: str
    name: str
    guid: str
    identifier: str
    parameters: tuple[Variable, ...]
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    states: tuple[Variable, ...]
    event_indicators: int
    has_directional_derivatives: bool
    needs_instance_per_process: bool
    derivatives: tuple[int, ...] = ()
    jacobian_pattern: tuple[tuple[int, ...], ...] | None = None
    wants_step_callback: bool = True
    candidate_copies: tuple[tuple[str, int], ...] = ()
    fmi_version: int = 2
    interface: Interface = "model exchange"
    takes_any_step: bool = True
    interpolates_inputs: bool = False
    step_size: float | None = None
    execution_tool: str = ""
    operators: tuple[DescribedOperator, ...] = ()
    relay: DescribedRelay | None = None
    fixed_starts: tuple[str, ...] = ()
    state_aliases: Mapping[str, str] = field(default_factory=dict, compare=False, repr=False)
    feedthrough: Mapping[int, frozenset[str]] = field(default_factory=dict, compare=False, repr=False)

    @property
    def units(self) -> dict[str, str]:
        """Unit of each parameter, input and output by its name."""
        return {v.name: v.unit for v in (*self.parameters, *self.inputs, *self.outputs)}

    def parameter(self, name: str) -> Variable:
        """Return the parameter of this name; InputError with the names there are otherwise."""
        return self._find("parameter", self.parameters, name)

    def input(self, name: str) -> Variable:
        """Return the input of this name."""
        return self._find("input", self.inputs, name)

    def output(self, name: str) -> Variable:
        """Return the output of this name; a state may be asked for by its own name too."""
        for variable in self.states:
            if variable.name == name:
                return variable
        return self._find("output", self.outputs, name)

    def state_index(self, name: str) -> int:
        """Position of a state, by the name of the state or of an output that is this state."""
        for index, variable in enumerate(self.states):
            if variable.name == name:
                return index
        copied = self.copied_state(name)
        if copied is None:
            raise InputError(f"{self.path.name}: no state {name!r} (states: {listed(self.states)})")
        return copied

    def copied_state(self, output: str) -> int | None:
        """Position of the state that an output is or copies; None if it is none, or there is no such output.

        An output shares its value reference with the state, or is one of :meth:`verified_copies`.
        """
        for variable in self.outputs:
            if variable.name == output and variable.kind == "real":
                for index, state in enumerate(self.states):
                    if state.value_reference == variable.value_reference:
                        return index
        return self.verified_copies().get(output) if output in dict(self.candidate_copies) else None

    def verified_copies(self) -> Mapping[str, int]:
        """Return those of ``candidate_copies`` that are known to equal their state.

        None, as long as nothing runs the FMU."""
        return {}

    def copies_by_name(self) -> Mapping[str, int]:
        """Verified copies after which OpenModelica has named the state: they equal it always, not only nearby."""
        named = set(outputs_named_by_states(self.states))
        if named.isdisjoint(dict(self.candidate_copies)):
            return {}
        return {output: state for output, state in self.verified_copies().items() if output in named}

    def _find(self, what: str, variables: tuple[Variable, ...], name: str) -> Variable:
        for variable in variables:
            if variable.name == name:
                return variable
        raise InputError(f"{self.path.name}: no {what} {name!r} ({what}s: {listed(variables)})")

    def unpack(self, folder: Path | str) -> Path:
        """Unpack into an existing private folder; returns the binary's path. No member leaves the folder."""
        archive.extract(self.path, Path(folder))
        return self.binary_in(folder)

    def binary_in(self, folder: Path | str) -> Path:
        """Return where the binary is in a folder into which the FMU was unpacked."""
        return Path(folder) / BINARY_FOLDERS[self.fmi_version] / f"{self.identifier}{this_machine().suffix}"


def outputs_named_by_states(states: Sequence[Variable]) -> dict[str, int]:
    """Outputs after which OpenModelica has named a state, and the position of that state."""
    return {m["output"]: i for i, state in enumerate(states) if (m := _OUTPUT_ALIAS.fullmatch(state.name))}


def listed(variables: Sequence[Variable]) -> str:
    """Return names for a message, at most twenty of them."""
    names = [v.name for v in variables]
    return ", ".join(names[:20]) + (", ..." if len(names) > 20 else "") if names else "none"
