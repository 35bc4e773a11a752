"""Models with laws written as Modelica: an extension of the user's class, or a copy of it with edits."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Self

from aero_bayes.errors import InputError
from aero_bayes.files import write_whole
from aero_bayes.laws.aliases import AliasStructure, alias_structure
from aero_bayes.laws.balance import Attachment, Port
from aero_bayes.laws.balance_writer import MAX_FORMULA_LENGTH, BalanceWriter
from aero_bayes.laws.candidates import PlacedLaw
from aero_bayes.laws.class_with_laws import ClassWithLaws
from aero_bayes.modelica.class_reader import read_classes
from aero_bayes.modelica.classes import ClassText, ComponentDeclaration, SourceStatement
from aero_bayes.modelica.compose import ACTING_SUFFIX, TRUE_SUFFIX
from aero_bayes.modelica.edits import TextEdit, apply_edits, insert_before_connector, text_of, unified_diff
from aero_bayes.modelica.flat import FlatModel, element_names
from aero_bayes.modelica.library import rig_packages
from aero_bayes.modelica.parse import Token, find_outside, split_outside, tokenize, words_of
from aero_bayes.modelica.sources import SourceFile, Sources, modelica_files, read_file, read_modelica_text
from aero_bayes.modelica.syntax import parse_reference


class ConnectionWriter:
    """Writes laws at connections."""

    def __init__(self, target: ClassWithLaws, known: Sources, structure: AliasStructure) -> None:
        self.target, self.known, self.structure = target, known, structure

    def write_at_node(self, placed: PlacedLaw) -> None:
        port = placed.port
        wired = self.target.wires[placed.instance]
        terms = dict(zip(("port", "neighbour"), wired.added, strict=False))
        ends = {end: added.port.connectors[0] for end, added in terms.items()}
        flows = [f"{end}.{a.port.flow} = {'' if a.sign > 0 else '-'}{a.output};" for end, a in terms.items()]
        inside = self._inside(port)
        if placed.law.kind == "exchange":
            inside = {"h_1": f"port.{port.potential}", "h_2": f"neighbour.{port.potential}"}
        elif placed.neighbour is not None and port.kind == "motion":
            other = {k: v.replace("port.", "neighbour.") for k, v in self._inside(placed.neighbour).items()}
            inside = {k: f"{v} - {other[k]}" for k, v in inside.items() if k in other}
        given = {read.input: self.target.called(read) for read in wired.reads if read.input not in inside}
        self.target.declare(placed, given, inside, self._connectors(port, *ends), flows)
        self.target.equations += [f"connect({placed.instance}.{end}, {outer});" for end, outer in ends.items()]

    def _inside(self, port: Port) -> dict[str, str]:
        """Return what a law's class can take from its own connector: the potential, or its rate."""
        potential = f"port.{port.potential}"
        if port.kind == "storage":
            return {"h": potential}
        position = port.signals.get("x")
        own = self.structure.of(f"{port.connectors[0]}.{port.potential}")
        if position is not None and own == self.structure.of(position.first):
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
        reads = self.target.wires[placed.instance].reads
        given = {read.input: self.target.called(read) for read in reads if read.input != "i"}
        self.target.declare(placed, given, {"i": f"p.{port.flow}"}, self._connectors(port, "p", "n"), equations)
        mine = [
            u.instance
            for u in self.target.placed_laws
            if u.port.attachment == "series" and u.port.connectors[1] == right
        ]
        if placed.instance != mine[0]:
            return
        chain = [(f"{c}.p", f"{c}.n") for c in mine]
        edits = insert_before_connector(self.target.file.text, self.target.cls.equations, right, chain)
        if not edits:
            raise InputError(f"{self.target.cls.full_name}: no connection of {left} and {right} stands in the class")
        self.target.edits += edits


class SignalWriter:
    """Writes laws at inputs, outputs and signals inside a class."""

    def __init__(self, target: ClassWithLaws, structure: AliasStructure) -> None:
        self.target, self.structure = target, structure

    def write_at_input(self, placed: PlacedLaw) -> None:
        name = str(placed.port.signals["u"])
        c = self._declared(name)
        self._declare(placed, name)
        given, inner = self.target.replacements, name
        if c.name != name:
            if c.name not in self.target.replacements:
                self.target.replacements[c.name] = self._apart(c, ACTING_SUFFIX)
            given, inner = self.target.sources, name.replace(c.name, self.target.replacements[c.name], 1)
        if self.target.wires[placed.instance].outermost:
            given[inner] = f"{placed.instance}.y"

    def write_at_signal(self, placed: PlacedLaw) -> None:
        name = str(placed.port.signals["u"])
        if "." not in name:
            self.target.computed.add(name)
            self.write_at_input(placed)
            return
        connects = component_connections(self.target.cls, name)
        if len(connects) != 1:
            raise InputError(f"{self.target.cls.full_name}: no one connection to {name!r} stands in the class")
        ((statement, source),) = connects
        self._declare(placed, source)
        if self.target.wires[placed.instance].outermost:
            self.target.edits.append(TextEdit(statement.start, statement.end, f"{name} = {placed.instance}.y;"))

    def _declare(self, placed: PlacedLaw, source: str) -> None:
        """Declare a law that acts on a signal, which is a ``source`` in the class, and reads others."""
        reads = self.target.wires[placed.instance].reads
        given = {r.input: source if r.input == "u" and r.after is None else self.target.called(r) for r in reads}
        self.target.declare(placed, given, {})

    def _apart(self, c: ComponentDeclaration, suffix: str) -> str:
        """Return an array that stands, element by element, for an array of inputs or outputs in the class."""
        sizes = self.structure.variables[c.name].sizes
        inner = f"{c.name}{suffix}"
        if c.binding:
            self.target.freed_bindings[inner] = c.binding
        if suffix == ACTING_SUFFIX and "input" not in c.prefixes:
            # a connector that takes its causality from its class
            c = replace(c, type="Acting")
            self.target.connectors["Acting"] = "output Real"
        self._declare_like(
            c, f"{inner}[{', '.join(map(str, sizes))}]", "unread" if suffix == TRUE_SUFFIX else "as it acts"
        )
        for outer, own in zip(element_names(c.name, sizes), element_names(inner, sizes), strict=True):
            self.target.sources |= {own: outer} if suffix == ACTING_SUFFIX else {outer: own}
        return inner

    def _declared(self, name: str) -> ComponentDeclaration:
        base = parse_reference(name).name
        if base not in self.target.components:
            raise InputError(f"{self.target.cls.full_name}: {base!r} is not declared in the class itself")
        return self.target.components[base]

    def write_at_output(self, placed: PlacedLaw) -> None:
        name = str(placed.port.signals["u"])
        c = self._declared(name)
        if c.name != name and c.name not in self.target.replacements:
            self.target.replacements[c.name] = self._apart(c, TRUE_SUFFIX)
            self._without_start(c)
        inner = self.target.sources.get(name)
        self.target.sources[name] = f"{placed.instance}.y"
        if inner is not None:
            self._declare(placed, inner)
            return
        giving = [s for s in self.target.cls.equations if [t.word for t in s.core[:2]] == [name, "="] and not s.inside]
        if c.binding or (len(giving) == 1 and name not in self.target.cls.derived()):
            self.target.moved_equations[name] = c.binding or giving[0].core[2:]
            self._declare(placed, "")
            self.target.replacements[name] = f"{placed.instance}.u"
        else:
            # Other equations solve for it: what it was gets a name of its own.
            true = f"{name}{TRUE_SUFFIX}"
            self._declare(placed, true)
            self._declare_like(c, true, "unread")
            self._without_start(c)
            self.target.replacements[name] = true

    def _declare_like(self, c: ComponentDeclaration, name: str, about: str) -> None:
        # a connector stays one, since it may be connected
        modified = text_of(self.target.file.text, c.arguments)
        self.target.variables.append(f'{c.type} {name}{modified} "{c.description or c.name}, {about}";')

    def _without_start(self, c: ComponentDeclaration) -> None:
        """Keep only the units of what is no state any more."""
        if c.arguments:
            parts = split_outside(c.arguments[1:-1])
            kept = [
                p for p in parts if {"unit", "displayUnit"} & {t.word for t in p[: find_outside(p, frozenset({"="}))]}
            ]
            text = f"({', '.join(text_of(self.target.file.text, p) for p in kept)})" if kept else ""
            self.target.edits.append(TextEdit(c.arguments[0].start, c.arguments[-1].end, text))


def component_connections(cls: ClassText, name: str) -> list[tuple[SourceStatement, str]]:
    """Return the connections of a component's input, with what stands at the other end; none in a loop or condition.

    What is connected otherwise too has no other end."""
    found = []
    for s in cls.equations:
        ends = ["".join(words_of(end)) for end in s.ends]
        if name in ends and not s.inside:
            found.append((s, next((end for end in ends if end != name), "")))
    return found


#: Laws at outputs are written first, then those at inputs: a law in a balance reads the variables that these declare.
_WRITING_ORDER: Mapping[Attachment, int] = {"output": 0, "input": 1}


def read_sources(sources: Sequence[Path], flat: FlatModel | None = None) -> Sources:
    """Read the files and package folders of a model, and the shipped packages of rigs.

    Of libraries, only the files are read that declare something in ``flat``, and the packages around these."""
    files: dict[str, SourceFile] = {}
    for source in (*rig_packages(), *map(Path, sources)):
        if not source.exists():
            raise InputError(f"{source}: no such file")
        for path in modelica_files([source]):
            name = str(path.relative_to(source.parent))
            files[name] = read_file(path, name)
    places = [] if flat is None else [v.place for v in flat.variables] + [e.place for e in flat.equations]
    for place in dict.fromkeys(p.file for p in places if p is not None):
        if place not in files and Path(place).is_absolute() and Path(place).is_file():
            files[place] = read_file(Path(place), place)
            # the packages around it may import names
            for package in (f / "package.mo" for f in Path(place).parents):
                if not package.is_file():
                    break
                if str(package) not in files:
                    files[str(package)] = read_file(package, str(package))
    return Sources(files)


def reserved_names(flat: FlatModel, sources: Sequence[Path]) -> set[str]:
    """Return names that a new variable must not have.

    Those of variables of the model, and of loop indices in its sources."""
    loops = set[str]()
    for path in modelica_files(sources):
        words = words_of(tokenize(read_modelica_text(path)))
        loops |= {after for word, after in pairwise(words) if word == "for"}
    return {v.name for v in flat.variables} | loops


@dataclass(frozen=True)
class WrittenModel:
    """A written model: its name, file and text, and the text of the class of the user with its name.

    To export it, give the sources of the original and ``path``."""

    name: str
    path: Path
    text: str
    before: str
    before_name: str

    @property
    def diff(self) -> str:
        """The unified diff from the class of the user."""
        return unified_diff(self.before, self.text, self.before_name, self.path.name)

    def with_values(self, values: Mapping[str, float], starts: Mapping[str, float]) -> Self:
        """Return the model with other values of parameters, and starts of states, that its class declares."""
        edits = []
        for c in (c for cls in read_classes(self.text) if cls.name == self.name for c in cls.components()):
            if c.name in values and "parameter" in c.prefixes:
                edits += _valued(c.binding, values[c.name])
            elif c.name in starts:
                edits += _valued(dict(c.modifiers).get("start", ()), starts[c.name])
        text = apply_edits(self.text, edits)
        write_whole(self.path, text)
        return replace(self, text=text)


def _valued(given: Sequence[Token], value: float) -> list[TextEdit]:
    """Return the edit that puts a number with the digits of a fit in place of an expression."""
    return [TextEdit(given[0].start, given[-1].end, f"{float(f'{value:.6g}')!r}")] if given else []


def write_laws(
    sources: Sequence[Path],
    model: str,
    flat: FlatModel,
    placed_laws: Sequence[PlacedLaw],
    out_dir: Path | str,
    name: str = "",
    max_formula_length: int = MAX_FORMULA_LENGTH,
) -> WrittenModel:
    """Write a model with laws to ``out_dir/<name>.mo``.

    If all laws are at connections, the model extends the class of the user. Otherwise it is a copy of that class, with
    comments and layout kept. With a ``max_formula_length`` of 0 all laws are components, whose constants have names."""
    title = name or _name(model, placed_laws)
    text, before, old = _edited_source(sources, model, flat, placed_laws, title, max_formula_length)
    path = Path(out_dir) / f"{title}.mo"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, text)
    return WrittenModel(title, path, text, before, old)


def can_be_written(sources: Sequence[Path], model: str, flat: FlatModel, placed: PlacedLaw) -> bool:
    """Return whether the source of a model has a place for a law, see :func:`write_laws`."""
    try:
        _edited_source(sources, model, flat, [placed], _name(model, [placed]))
    except InputError:
        return False
    return True


def _name(model: str, placed_laws: Sequence[PlacedLaw]) -> str:
    """Name the written class after the model and its laws."""
    return "_".join([model.rpartition(".")[2], *(p.instance for p in placed_laws if not p.is_twin)])


def _edited_source(
    sources: Sequence[Path],
    model: str,
    flat: FlatModel,
    placed_laws: Sequence[PlacedLaw],
    title: str,
    max_formula_length: int = MAX_FORMULA_LENGTH,
    *,
    inherits: bool = False,
) -> tuple[str, str, str]:
    """Return the text with laws, and the text before with its name, for the diff.

    Laws with a longer formula, and all others but terms, are components. Where something that is to be edited stands in
    a base class, base classes are written out (``inherits``)."""
    known, structure = read_sources(sources, flat), alias_structure(flat)
    user = known.find(model)
    target = ClassWithLaws(known, user, placed_laws, title, inherits=inherits)
    signals, connections = SignalWriter(target, structure), ConnectionWriter(target, known, structure)
    write: Mapping[str, Callable[[PlacedLaw], None]] = {
        "input": signals.write_at_input,
        "output": signals.write_at_output,
        "signal": signals.write_at_signal,
        "equation": BalanceWriter(target, known, flat, structure, max_formula_length).write,
        "node": connections.write_at_node,
        "series": connections.write_in_series,
    }
    try:
        for placed in sorted(placed_laws, key=lambda p: _WRITING_ORDER.get(p.port.attachment, 2)):
            write[placed.port.attachment](placed)
    except InputError:
        if inherits or not user[1].bases():
            raise
        return _edited_source(sources, model, flat, placed_laws, title, max_formula_length, inherits=True)
    before, old = ("", "/dev/null") if target.extends else (target.original(), user[0].file)
    return target.written(), before, old
