"""Reads from Modelica source what a diagram is made of: components, connections and graphical annotations.

Equations are not understood, and nothing is checked: the exporter has done that before. What this reader does not know
it passes over.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

_TOKEN = re.compile(
    r'//[^\n]*|/\*.*?\*/|(?P<text>"(?:[^"\\]|\\.)*")|(?P<number>\d+\.?\d*(?:[eE][+-]?\d+)?)'
    r"|(?P<name>\.?[A-Za-z_]\w*(?:\s*\.\s*[A-Za-z_]\w*)*|'[^']*')|(?P<mark>:=|<=|>=|==|<>|[^\s\w])",
    re.DOTALL,
)
_CLASSES = {"model", "block", "class", "connector", "record", "package", "function", "type", "operator"}
_PREFIXES = {
    "final", "inner", "outer", "replaceable", "parameter", "constant", "input", "output", "flow", "stream", "discrete",
    "redeclare", "each", "partial", "encapsulated", "expandable", "pure", "impure",
}  # fmt: skip
_SECTIONS = {"equation", "algorithm", "public", "protected", "initial"}


@dataclass(frozen=True)
class Call:
    """``name(1, key = value)`` of an annotation or modifier; its arguments may be calls, lists, numbers or texts."""

    name: str
    items: tuple[object, ...] = ()
    keys: dict[str, object] = field(default_factory=dict)

    def find(self, name: str) -> Call | None:
        """The argument that is a call of this name."""
        return next((item for item in self.items if isinstance(item, Call) and item.name == name), None)


@dataclass(frozen=True)
class Part:
    """A declared component: its type as written, modifiers, the names that they use, and placement."""

    name: str
    type: str
    prefixes: frozenset[str]
    modifiers: Call
    description: str
    annotation: Call
    uses: tuple[str, ...] = ()


@dataclass(frozen=True)
class Link:
    """``connect(first, second)``, or an equation that only hands a value on."""

    first: str
    second: str
    annotation: Call


@dataclass
class Class:
    """A class as its source says it. ``aliases`` are its short classes, such as replaceable models."""

    name: str
    kind: str = "model"
    description: str = ""
    parts: list[Part] = field(default_factory=list)
    links: list[Link] = field(default_factory=list)
    bases: list[Call] = field(default_factory=list)
    aliases: dict[str, str] = field(default_factory=dict)
    annotation: Call = field(default_factory=lambda: Call("annotation"))


Library = dict[str, Class]


def read_library(files: Iterable[Path]) -> Library:
    """All classes of Modelica files, by full name."""
    library: Library = {}
    for path in files:
        _Reader(path.read_text(encoding="utf-8", errors="replace"), library).read()
    return library


class _Reader:
    """One pass over the tokens of a file."""

    def __init__(self, text: str, library: Library) -> None:
        self._tokens = [m.group() for m in _TOKEN.finditer(text) if m.lastgroup]
        self._at = 0
        self._library = library

    def read(self) -> None:
        within = ""
        if self._take("within"):
            within = self._next() if self._peek() != ";" else ""
            self._skip()
        while self._at < len(self._tokens):
            before = self._at
            self._prefixes()
            if self._peek() in _CLASSES:
                self._class(within)
            if self._at == before:
                self._at += 1

    def _class(self, within: str) -> Class | None:
        kind = self._next()
        while self._peek() in _CLASSES:  # "operator record"
            kind = self._next()
        name = self._next()
        if self._peek() == "=":
            return None
        found = Class(f"{within}.{name}".strip("."), kind, self._text())
        self._library[found.name] = found
        equations = False
        while self._at < len(self._tokens):
            if self._take("end"):
                within_body = self._peek() in {"if", "for", "when", "while"}
                self._skip()
                if not within_body:
                    break
                continue
            if self._peek() in _SECTIONS:
                equations = self._next() in {"equation", "algorithm", "initial"}
            elif self._peek() == "annotation":
                found.annotation = self._annotation()
                self._skip()
            elif equations:
                self._equation(found)
            else:
                self._element(found)
        return found

    def _element(self, found: Class) -> None:
        if self._take("extends"):
            found.bases.append(self._call(self._next()))
            self._skip()
            return
        prefixes = self._prefixes()
        if self._peek() in _CLASSES:
            start = self._at
            if self._class(found.name) is None:
                self._at = start + 1
                name = self._next()
                self._at += 1
                found.aliases[name] = self._next()
                self._skip()
            return
        if self._peek() in {"import", ";"} or not re.match(r"[A-Za-z_.]", self._peek()):
            self._skip()
            return
        type_ = self._next()
        if self._peek() == "[":
            self._value()
        while self._peek() not in {";", ""}:
            self._component(found, type_, prefixes)
            if not self._take(","):
                break
        self._skip()

    def _component(self, found: Class, type_: str, prefixes: frozenset[str]) -> None:
        name = self._next()
        start = self._at
        if self._peek() == "[":
            self._value()
        modifiers = self._call(name)
        while self._peek() not in {";", ",", "annotation", ""} and not self._peek().startswith('"'):
            self._value()
        written = zip(self._tokens[start : self._at], self._tokens[start + 1 :], strict=False)
        uses = tuple(dict.fromkeys(token for token, after in written if after != "=" and re.match(r"[A-Za-z_]", token)))
        description = self._text()
        while self._peek() not in {";", ",", "annotation", ""}:
            self._at += 1
        annotation = self._annotation() if self._peek() == "annotation" else Call("annotation")
        found.parts.append(Part(name, type_, prefixes, modifiers, description, annotation, uses))

    def _equation(self, found: Class) -> None:
        if self._peek() == "connect":
            pair = self._call(self._next())
            ends = [item for item in pair.items if isinstance(item, str)]
            annotation = self._annotation() if self._peek() == "annotation" else Call("annotation")
            if len(ends) == 2:
                found.links.append(Link(ends[0], ends[1], annotation))
        elif self._tokens[self._at + 1 : self._at + 2] == ["="] and self._tokens[self._at + 3 : self._at + 4] == [";"]:
            found.links.append(Link(self._tokens[self._at + 2], self._peek(), Call("annotation")))
        self._skip()

    def _annotation(self) -> Call:
        return self._call(self._next())

    def _call(self, name: str) -> Call:
        """The argument list that follows, if one does."""
        items: list[object] = []
        keys: dict[str, object] = {}
        if not self._take("("):
            return Call(name)
        while self._at < len(self._tokens) and not self._take(")"):
            self._prefixes()
            if self._peek() in _CLASSES:  # redeclare model A = B
                self._at += 1
            if self._tokens[self._at + 1 : self._at + 2] == ["="]:
                key = self._next()
                self._at += 1
                keys[key] = self._value()
            else:
                items.append(self._value())
            while self._peek() not in {",", ")", ""}:  # the rest of an expression
                self._value()
            self._take(",")
        return Call(name, tuple(items), keys)

    def _value(self) -> object:
        token = self._next()
        if token in {"{", "(", "["}:
            closing = {"{": "}", "(": ")", "[": "]"}[token]
            values = []
            while self._at < len(self._tokens) and not self._take(closing):
                values.append(self._value())
                self._take(",")
            return values
        if token == "-" and re.match(r"\d", self._peek()):
            return -float(self._next())
        if re.match(r"\d", token):
            return float(token)
        if token.startswith('"'):
            return token[1:-1]
        return self._call(token) if self._peek() == "(" else token

    def _prefixes(self) -> frozenset[str]:
        found = set()
        while self._peek() in _PREFIXES:
            found.add(self._next())
        return frozenset(found)

    def _text(self) -> str:
        text = ""
        while self._peek().startswith('"'):
            text += self._next()[1:-1]
            self._take("+")
        return text

    def _skip(self) -> None:
        """To behind the next semicolon."""
        while self._at < len(self._tokens) and self._next() != ";":
            pass

    def _peek(self) -> str:
        return self._tokens[self._at] if self._at < len(self._tokens) else ""

    def _next(self) -> str:
        self._at += 1
        return self._tokens[self._at - 1] if self._at <= len(self._tokens) else ""

    def _take(self, token: str) -> bool:
        taken = self._peek() == token
        self._at += taken
        return taken
