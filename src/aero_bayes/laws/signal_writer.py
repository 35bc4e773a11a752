"""Laws written at inputs, outputs and signals inside a class."""

from __future__ import annotations

from dataclasses import replace

from aero_bayes.errors import InputError
from aero_bayes.export.compose import ACTING_SUFFIX, TRUE_SUFFIX, element_names
from aero_bayes.language.classes import ClassText, ComponentDeclaration, SourceStatement
from aero_bayes.language.edits import TextEdit, text_of
from aero_bayes.language.syntax import parse_reference
from aero_bayes.language.tokens import find_outside, split_outside, words_of
from aero_bayes.laws.class_with_laws import ClassWithLaws
from aero_bayes.laws.placed_law import PlacedLaw
from aero_bayes.ports import AliasStructure

_EQUALS = frozenset({"="})


class SignalWriter:
    """Writes laws at inputs, outputs and signals inside a class."""

    def __init__(self, target: ClassWithLaws, structure: AliasStructure) -> None:
        self.target, self.structure = target, structure

    def write_at_input(self, placed: PlacedLaw) -> None:
        name = placed.port.signals["u"]
        c = self._declared(name)
        self._declare(placed, name)
        given, inner = self.target.replacements, name
        if c.name != name:
            if c.name not in self.target.replacements:
                self.target.replacements[c.name] = self._apart(c, ACTING_SUFFIX)
            given, inner = self.target.sources, name.replace(c.name, self.target.replacements[c.name], 1)
        if given.get(inner, name) != name:
            # chain: the existing law reads the new law's output
            self.target.instances[given[inner].removesuffix(".y")][1]["u"] = f"{placed.instance}.y"
        else:
            given[inner] = f"{placed.instance}.y"

    def write_at_signal(self, placed: PlacedLaw) -> None:
        name = placed.port.signals["u"]
        if "." not in name:
            self.target.computed.add(name)
            self.write_at_input(placed)
            return
        connects = component_connections(self.target.cls, name)
        if len(connects) != 1:
            raise InputError(f"{self.target.cls.full_name}: no one connection to {name!r} stands in the class")
        ((statement, source),) = connects
        mine = [
            u.instance for u in self.target.placed_laws if u.port.attachment == "signal" and u.port.signals["u"] == name
        ]
        # each is given what the next one gives, the last one what was connected
        given = dict(zip(mine, [*(f"{next_}.y" for next_ in mine[1:]), source], strict=True))
        self._declare(placed, given[placed.instance])
        if placed.instance == mine[0]:
            self.target.edits.append(TextEdit(statement.start, statement.end, f"{name} = {placed.instance}.y;"))

    def _declare(self, placed: PlacedLaw, acted_on: str) -> None:
        """Declare a law that acts on a signal, and reads others; an output with a law of its own is read without it."""
        outputs = {p.port.signals["u"] for p in self.target.placed_laws if p.port.attachment == "output"}
        read = {
            signal: self.target.replacements.get(name, name) if name in outputs else name
            for signal, name in placed.port.signals.items()
        }
        self.target.declare(placed, {**read, "u": acted_on}, {})

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
        name = placed.port.signals["u"]
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
            kept = [p for p in parts if {"unit", "displayUnit"} & {t.word for t in p[: find_outside(p, _EQUALS)]}]
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
