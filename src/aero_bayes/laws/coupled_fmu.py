"""One FMU made of several: a base, and the laws that are attached to it.

The binary (``native/coupler.c``) is the same for all. A table among the resources says which value goes where.
"""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import aero_bayes.simulation
from aero_bayes.errors import InputError
from aero_bayes.modelica.build import compile_kept, this_machine, write_archive
from aero_bayes.modelica.codegen import GIVEN, HELD
from aero_bayes.modelica.embedded import DescribedVariable, add_variables
from aero_bayes.simulation.fmi_description import add_annotations
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.model_description import BINARY_FOLDERS, DescribedOperator, DescribedRelay, Memory, Variable

#: In place of a part: the source of a value is an input of the whole, or a state of the base, by its position.
INPUT, STATE = -2, -1
BASE = 0
#: In place of the input on which a law acts.
AT_OUTPUT, DELAYS_OUTPUT = -1, -2
#: Suffix of a state's name where a law acts on the output of the same name.
UNREAD_SUFFIX = "_unread"
_ENGINE = Path(aero_bayes.simulation.__file__).parent / "native"
_OWN = Path(__file__).parent / "native"
_COUPLER = ("coupler.c", "coupling_file.c", "coupled_equations.c", "bind.c", "fmi3.c")
_HEADERS = (_OWN / "coupler.h", _ENGINE / "fmu_library.h")
_SOURCES = (*(_OWN / name for name in _COUPLER[:3]), *(_ENGINE / name for name in _COUPLER[3:]), *_HEADERS)
_FLAGS = ("-shared", "-s", "-Wl,--build-id=none", "coupled_form.c", "coupler.o", "-lm", "-ldl")
_TAGS = {"real": "Real", "integer": "Integer", "boolean": "Boolean"}
#: Functions that an FMU of our own exporter has whose equations hold without events, are linear, or are while its step
#: is held; and that of coupled ones, whose mark may hold only without operators.
_EVENTLESS, _LINEAR, _LINEAR_HELD, _COUPLED = b"ab_eventless", b"ab_linear\0", b"ab_linear_held", b"ab_operators_off"
#: That of one whose derivatives are had all at once.
_COLUMNS = b"ab_columns"


@dataclass(frozen=True)
class Source:
    """Where a value comes from: a variable of a part, or ``INPUT`` or ``STATE`` and a position."""

    part: int
    reference: int


#: A sum of values with factors.
LinearSum = tuple[tuple[Source, float], ...]


@dataclass(frozen=True)
class Setting:
    """An input of a part, and what it is set to."""

    part: int
    reference: int
    terms: LinearSum


@dataclass(frozen=True, eq=False)
class AttachedLaw:
    """A law's FMU under a name.

    ``parameters`` are variables for those that are shown, by their names in the FMU; ``given`` has values of others and
    of inputs that nothing sets, ``nominals`` those of its states."""

    name: str
    model: Model
    parameters: Mapping[str, Variable]
    given: Mapping[str, float]
    nominals: Sequence[float] = ()


@dataclass(frozen=True)
class SignalOperator:
    """Laws that act on a signal one after the other and read nothing else, by the positions of all.

    ``signal`` is an input of the whole; a simulator may apply them to it beforehand, and leave their equations out. One
    law there may remember the signal (``memory``). Or it is a value behind ``output``, to whose samples a simulator may
    apply them; the first one may delay a state."""

    laws: tuple[int, ...]
    signal: Source
    output: str = ""
    memory: Memory = ""


@dataclass(frozen=True)
class Relay:
    """A law, by its position, that steps by the sign of a speed: a sum of states of the base.

    A simulator may hold it on a side, and let the model rest."""

    law: int
    speed: LinearSum


@dataclass(frozen=True, eq=False)
class Coupling:
    """A base, laws, and what their inputs are set to, in an order in which everything is known when it is needed.

    ``inputs`` of the base are those of the whole, ``outputs`` those that are another variable than in the base, such as
    what a law makes of one. ``state_names`` are those of the base's states in the whole, if others than there."""

    base: Model
    laws: Sequence[AttachedLaw]
    settings: Sequence[Setting]
    inputs: Sequence[str]
    outputs: Mapping[str, Source] = field(default_factory=dict)
    hidden: frozenset[str] = frozenset()
    state_names: Sequence[str] = ()
    operators: Sequence[SignalOperator] = ()
    relay: Relay | None = None


def couple(coupling: Coupling, out: Path) -> None:
    """Write an FMU 2.0 for Model Exchange that is the base with its laws."""
    base = coupling.base
    if base.interface != "model exchange":
        raise InputError(
            f"{base.path}: laws are put around an FMU with Model Exchange; this one has co-simulation only"
        )
    table = _Table(coupling)
    parts = _binaries(base, "part0") | {k: v for i, law in enumerate(coupling.laws, 1)
                                        for k, v in _binaries(law.model, f"part{i}").items()}  # fmt: skip
    members = {
        f"{BINARY_FOLDERS[2]}/coupled{this_machine().suffix}": compile_kept(
            (_OWN / "coupled_form.c", *_HEADERS),
            (*_FLAGS, *_form(coupling, parts)),
            "coupled.so",
            objects={"coupler.o": compile_kept(_SOURCES, ("-r", "-nostdlib", *_COUPLER), "coupler.o")},
        ),
        "resources/coupling.txt": table.text().encode(),
        **{f"resources/{name}": data for name, data in parts.items()},
    }
    digest = hashlib.sha256(b"".join(members[k] for k in sorted(members))).hexdigest()
    write_archive(out, {"modelDescription.xml": table.description(digest[:32]), **members}, packed=False)


def _form(coupling: Coupling, parts: Mapping[str, bytes]) -> Iterator[str]:
    """Yield flags that say what all parts can do, and which form the equations have, or those that operators leave.

    Laws without states that act on nothing but an output of the whole have no part in the equations."""
    of = {int(name[4 : name.index("/")]): data for name, data in parts.items()
          if name.endswith(this_machine().suffix) and "/resources/" not in name}  # fmt: skip
    count = len(coupling.laws) + 1
    if len(of) == count and all(_COLUMNS in data for data in of.values()):
        yield "-DCOLUMNS"
    if len(of) < count or not all(_EVENTLESS in data for data in of.values()):
        return
    yield "-DEVENTLESS"
    feeding = {source.part for s in coupling.settings for source, _ in s.terms}
    behind = {k for k, law in enumerate(coupling.laws, 1) if not law.model.states and k not in feeding}
    bent = {k for k, data in of.items() if _LINEAR not in data or _COUPLED in data} - behind
    held = {k for k in bent if coupling.relay is not None and k == coupling.relay.law + 1 and _LINEAR_HELD in of[k]}
    if bent - held <= {law + 1 for o in coupling.operators if not o.output for law in o.laws}:
        yield f"-DLINEAR={1 + 2 * bool(bent - held) + 4 * bool(held)}"


def _binaries(model: Model, folder: str) -> dict[str, bytes]:
    """Return the files of an FMU that its binary may need, under the name of a folder."""
    return {f"{folder}/{name}": data for name, data in _files(model.path, model.sha256, model.fmi_version).items()}


@lru_cache(maxsize=128)
def _files(path: Path, sha256: str, version: int) -> dict[str, bytes]:
    binaries = f"{BINARY_FOLDERS[version]}/"  # whose content needs no folders of its own: each costs a millisecond
    with zipfile.ZipFile(path) as archive:
        names = [n for n in archive.namelist() if n.startswith((binaries, "resources/")) and not n.endswith("/")]
        return {n.removeprefix(binaries): archive.read(n) for n in names}


@dataclass(frozen=True)
class _Shown:
    """A variable of the coupled model's description, and whose variables it stands for."""

    v: Variable
    name: str
    causality: str
    owners: tuple[tuple[int, int], ...]
    slot: int = -1
    variability: str = "continuous"
    initial: str = ""
    start: float | None = None
    derivative_of: str = ""
    depends: tuple[str, ...] | None = None
    alias_of: str = ""
    listed: bool = True  # among the unknowns of initialisation


class _Table:
    """The table of a coupling and its model description. A value reference counts the variables of the description."""

    def __init__(self, coupling: Coupling) -> None:
        self.coupling = coupling
        self.models = (coupling.base, *(law.model for law in coupling.laws))
        self.first_state = len(coupling.inputs)
        self.slots = self.first_state + len(coupling.base.states)
        self.ready = [0] * len(self.models)
        self.transfers = [*self._transfers()]
        self.shown = [*self._shown()]

    def _transfers(self) -> Iterator[str]:
        """Yield a line for each transfer; settings of one part that follow one another are made at once."""
        groups: list[list[Setting]] = []
        for s in self.coupling.settings:
            if groups and groups[-1][0].part == s.part:
                groups[-1].append(s)
            else:
                groups.append([s])
        count = 0
        for group in groups:
            places: dict[Source, int] = {}
            asked: dict[int, list[Source]] = {}
            for source in dict.fromkeys(source for s in group for source, _ in s.terms):
                if source.part >= 0:
                    asked.setdefault(source.part, []).append(source)
                else:
                    places[source] = source.reference + (self.first_state if source.part == STATE else 0)
            for part, sources in asked.items():
                places |= {source: self.slots + k for k, source in enumerate(sources)}
                yield _row(part, self.slots, len(sources), *(source.reference for source in sources))
                self.slots += len(sources)
                count += 1
            numbers: list[float] = []
            for s in group:
                numbers += [s.reference, len(s.terms), *(x for source, gain in s.terms for x in (places[source], gain))]
            yield _row(group[0].part, -1, len(group), *numbers)
            count += 1
            self.ready[group[0].part] = count

    def text(self) -> str:
        """Return the table that ``coupling_file.c`` reads."""
        base, laws = self.coupling.base, self.coupling.laws
        lines = [_row(len(self.models), self.first_state, self.slots, len(self.transfers), len(self.shown))]
        lines.append(_row(*(base.input(name).start or 0.0 for name in self.coupling.inputs)))
        for k, model in enumerate(self.models):
            lines.append(_row(model.fmi_version, model.event_indicators, self.ready[k]))
            lines.append(f"part{k}/{model.binary_in('').name}")
            lines += [f"part{k}/resources", model.guid]
            lines.append(_row(len(model.states), *(s.value_reference for s in model.states)))
            given = laws[k - 1].given if k else {}
            references = {v.name: v.value_reference for v in (*model.parameters, *model.inputs)}
            values = [(references[n], x) for n, x in given.items()]
            lines.append(_row(len(values), *(x for pair in values for x in pair)))
            nominals = laws[k - 1].nominals if k else ()
            lines.append(_row(len(nominals), *nominals))
        lines.append(_row(*(int(not s.settable_start) for s in base.states)))
        lines += self.transfers
        lines += [_row(v.slot, len(v.owners), *(x for owner in v.owners for x in owner)) for v in self.shown]
        chains = [
            (k, law, o.signal.reference if not o.output else DELAYS_OUTPUT if o.memory and not j else AT_OUTPUT)
            for k, o in enumerate(self.coupling.operators)
            for j, law in enumerate(o.laws)
        ]
        lines.append(_row(len(chains)))
        for k, law, at in chains:
            u, y = laws[law].model.input("u"), laws[law].model.output("y")
            lines.append(_row(k, law + 1, at, u.value_reference, y.value_reference))
        return "\n".join(lines) + "\n"

    def _shown(self) -> Iterator[_Shown]:
        """Yield the variables in the order of the model description."""
        coupling, base, acted = self.coupling, self.coupling.base, self.coupling.outputs
        plain = [v for v in base.outputs if v.name not in acted and v.name not in self.coupling.hidden]
        names = {v.name for v in plain} | {n for n, s in acted.items() if s.part == STATE}
        for i, (s, rate) in enumerate(zip(base.states, base.derivatives, strict=True)):
            name = self._state_name(i)
            initial = "exact" if s.start is not None else "calculated"
            yield _Shown(s, name, "output" if name in names else "local", ((BASE, s.value_reference),),
                         self.first_state + i, initial=initial, start=s.start)  # fmt: skip
            yield _rate(s, name, BASE, rate)
        for k, law in enumerate(self.coupling.laws, 1):
            nominals: Sequence[float | None] = law.nominals or [None] * len(law.model.states)
            for s, rate, nominal in zip(law.model.states, law.model.derivatives, nominals, strict=True):
                name = f"{law.name}.{s.name}"
                yield _Shown(
                    replace(s, nominal=nominal), name, "local", ((k, s.value_reference),), initial="calculated"
                )
                yield _rate(s, name, k, rate)
        for k, name in enumerate(self.coupling.inputs):
            v = base.input(name)
            yield _Shown(v, name, "input", (), k, start=v.start or 0.0)
        if coupling.relay is not None:
            law = coupling.laws[coupling.relay.law]
            for name in (HELD, GIVEN):
                v = law.model.input(name)
                owner = (coupling.relay.law + 1, v.value_reference)
                yield _Shown(v, f"{law.name}.{name}", "local", (owner,), initial="exact", start=0.0)
        yield from self._parameters()
        own = {self._state_name(k) for k in range(len(base.states))}
        for v in plain:
            state = base.copied_state(v.name) if v.name not in own else None
            kind = "continuous" if v.kind == "real" else "discrete"
            if state is not None:
                yield self._alias(v, state)
            elif v.name not in own:
                yield _Shown(v, v.name, "output", ((BASE, v.value_reference),), -1, kind, "calculated")
        for o in self.coupling.operators:
            if o.output and o.signal.part != STATE:
                v, owner = base.output(o.output), (o.signal.part, o.signal.reference)
                yield _Shown(v, self._raw_name(o), "local", (owner,), initial="calculated", listed=False)
        for v in base.outputs:
            if v.name in acted and v.name not in own:
                source = acted[v.name]
                if source.part == STATE:
                    yield self._alias(v, source.reference)
                else:
                    yield _Shown(v, v.name, "output", ((source.part, source.reference),), initial="calculated")

    def _states(self, o: SignalOperator) -> tuple[int, ...]:
        """Return the positions of the states of a law that remembers what it acts on."""
        if not o.memory:
            return ()
        first = sum(len(model.states) for model in self.models[: o.laws[0] + 1])
        return tuple(range(first, first + len(self.models[o.laws[0] + 1].states)))

    def _raw_name(self, o: SignalOperator) -> str:
        """Return the name of what laws at an output act on."""
        if o.signal.part == STATE:
            return self._state_name(o.signal.reference)
        first = self.coupling.laws[o.laws[0]]
        return f"{first.name}.{first.model.inputs[0].name}"

    def _alias(self, v: Variable, state: int) -> _Shown:
        """Return an output that is a state: both have one value reference."""
        owner, slot = (BASE, self.coupling.base.states[state].value_reference), self.first_state + state
        name = self._state_name(state)
        return _Shown(v, v.name, "output", (owner,), slot, initial="calculated", depends=(name,), alias_of=name)

    def _state_name(self, k: int) -> str:
        """Return the name of a state: with a suffix where the output of that name is another variable."""
        base, acted = self.coupling.base, self.coupling.outputs
        name = self.coupling.state_names[k] if self.coupling.state_names else base.states[k].name
        if name in acted:
            return name if acted[name] == Source(STATE, k) else f"{name}{UNREAD_SUFFIX}"
        other = any(v.name == name and base.copied_state(name) != k for v in base.outputs)
        return f"{name}{UNREAD_SUFFIX}" if other else name

    def _parameters(self) -> Iterator[_Shown]:
        owners = {v.name: (v, [(BASE, v.value_reference)]) for v in self.coupling.base.parameters}
        for k, law in enumerate(self.coupling.laws, 1):
            for inside, v in law.parameters.items():
                owners.setdefault(v.name, (v, []))[1].append((k, law.model.parameter(inside).value_reference))
        for name, (v, own) in owners.items():
            yield _Shown(
                v, name, "parameter", tuple(own), -1, "fixed", "exact", v.start if v.start is not None else 0.0
            )

    def _described_relay(self, place: Mapping[str, int]) -> DescribedRelay | None:
        relay = self.coupling.relay
        if relay is None:
            return None
        held, given = (place[f"{self.coupling.laws[relay.law].name}.{name}"] for name in (HELD, GIVEN))
        return DescribedRelay(held, given, tuple((source.reference, gain) for source, gain in relay.speed))

    def description(self, guid: str) -> bytes:
        """Write the modelDescription.xml."""
        base = self.coupling.base
        root = ET.Element(
            "fmiModelDescription", fmiVersion="2.0", modelName=base.name, guid=guid,
            generationTool="aero-bayes coupling", variableNamingConvention="flat",
            numberOfEventIndicators=str(sum(m.event_indicators for m in self.models)),
        )  # fmt: skip
        exchange = ET.SubElement(root, "ModelExchange", modelIdentifier="coupled")
        exchange.set("completedIntegratorStepNotNeeded", str(not base.wants_step_callback).lower())
        exchange.set("canBeInstantiatedOnlyOncePerProcess", str(base.needs_instance_per_process).lower())
        exchange.set("providesDirectionalDerivative", str(base.has_directional_derivatives).lower())
        units = sorted({s.v.unit for s in self.shown if s.v.unit and s.v.kind == "real"})
        if units:
            group = ET.SubElement(root, "UnitDefinitions")
            for unit in units:
                ET.SubElement(group, "Unit", name=unit)
        place = {s.name: k for k, s in enumerate(self.shown)}
        add_annotations(root, [
            DescribedOperator(o.output or self.coupling.inputs[o.signal.reference],
                              tuple(v.name for law in o.laws for v in self.coupling.laws[law].parameters.values()),
                              place[self._raw_name(o)] if o.output else None, o.memory, self._states(o))
            for o in self.coupling.operators
        ], self._described_relay(place))  # fmt: skip
        add_variables(root, [
            DescribedVariable(
                s.name, place[s.alias_of or s.name], s.causality, s.variability, s.initial, s.v.description,
                **_attributes(s.v), start=s.start, derivative_of=s.derivative_of,
                depends=s.depends, listed=s.listed,
            )
            for s in self.shown
        ])  # fmt: skip
        ET.indent(root)
        return f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(root, encoding="unicode")}\n'.encode()


def _rate(s: Variable, name: str, part: int, reference: int) -> _Shown:
    v = replace(s, unit="", description=f"Rate of {s.name}", minimum=None, maximum=None, nominal=None)
    return _Shown(v, f"der({name})", "local", ((part, reference),), initial="calculated", derivative_of=name)


def _row(*numbers: float) -> str:
    return " ".join(str(int(n)) if float(n).is_integer() and abs(n) < 1e15 else repr(float(n)) for n in numbers)


def _attributes(v: Variable) -> dict[str, Any]:
    """Return tag, unit and limits of a variable; only numbers have the latter."""
    if v.kind != "real":
        return {"tag": _TAGS[v.kind]}
    limits = (("min", v.minimum), ("max", v.maximum), ("nominal", v.nominal))
    return {"unit": v.unit, "limits": {key: value for key, value in limits if value is not None}}
