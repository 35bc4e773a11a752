"""Classes of Modelica as they are written: their statements, declarations, and where each stands."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

from aero_bayes.errors import InputError
from aero_bayes.modelica.parse import Token, find_outside, parse_expression, skip_group, split_outside
from aero_bayes.modelica.syntax import Expression, arguments_of

CLASS_WORDS = frozenset(
    {"class", "model", "block", "record", "connector", "type", "package", "function", "operator"}
)  # fmt: skip
_VARIABLE_PREFIXES = frozenset(
    {"parameter", "constant", "discrete", "input", "output", "flow", "stream", "final", "inner", "outer",
     "replaceable", "redeclare", "each"}
)  # fmt: skip
_MODIFYING = frozenset({"each", "final", "redeclare", "replaceable"})
_ANNOTATION = frozenset({"annotation"})
#: Values by the names of what they modify.
Modifiers = tuple[tuple[str, tuple[Token, ...]], ...]


@dataclass(frozen=True)
class SourceStatement:
    """An element that ends in a semicolon: a declaration, an extends clause, an equation.

    ``section`` is public, protected, equation, algorithm, or the last two with ``initial`` before them, or class for
    a short class definition; ``inside`` names the compound equations around it."""

    section: str
    tokens: tuple[Token, ...]
    start: int
    end: int
    inside: tuple[str, ...] = ()
    head: tuple[Token, ...] = ()

    @property
    def first(self) -> str:
        """The first word; empty for an empty statement."""
        return self.tokens[0].word if self.tokens else ""

    @property
    def ends(self) -> tuple[tuple[Token, ...], ...]:
        """What a ``connect`` joins; nothing for another statement."""
        return tuple(tuple(end) for end in split_outside(self.core[2:-1])) if self.first == "connect" else ()

    @property
    def core(self) -> tuple[Token, ...]:
        """The tokens before a description or an annotation."""
        return tuple(_without_comment(self.tokens))


@dataclass(frozen=True)
class ComponentDeclaration:
    """One declared variable or component, and where the parts of its declaration stand."""

    name: str
    type: str
    prefixes: frozenset[str]
    modifiers: Modifiers
    binding: tuple[Token, ...]
    description: str
    statement: SourceStatement
    type_tokens: tuple[Token, ...]
    name_token: Token
    arguments: tuple[Token, ...]
    annotation: tuple[Token, ...]


@dataclass
class ClassText:
    """A class with a body. Positions count characters of the source; ``start`` is that of its first prefix.

    ``classes`` are those with a body inside it, ``class_names`` the names of all inside it."""

    kind: str
    name: str
    start: int
    body: int
    name_token: Token
    within: str = ""
    description: str = ""
    end_name: Token | None = None
    close: int = 0
    end: int = 0
    statements: list[SourceStatement] = field(default_factory=list)
    sections: list[tuple[str, int, int]] = field(default_factory=list)
    classes: list[ClassText] = field(default_factory=list)
    class_names: list[str] = field(default_factory=list)
    annotation: tuple[Token, ...] = ()
    annotation_start: int = -1
    partial: bool = False

    @property
    def full_name(self) -> str:
        """The name with the packages around it."""
        return f"{self.within}.{self.name}" if self.within else self.name

    @property
    def equations(self) -> list[SourceStatement]:
        """Its statements in equation sections, initial ones left out."""
        return [s for s in self.statements if s.section == "equation"]

    @property
    def declarations(self) -> list[SourceStatement]:
        """Its statements in public and protected sections."""
        return [s for s in self.statements if s.section in ("public", "protected")]

    def components(self) -> list[ComponentDeclaration]:
        """Return everything that the class declares itself, in order."""
        return [c for s in self.declarations for c in _components(s)]

    def declared_in(self, statement: SourceStatement) -> list[ComponentDeclaration]:
        """Return what one of its statements declares."""
        return _components(statement) if statement.section in ("public", "protected") else []

    def bases(self) -> list[str]:
        """Return names of the classes that it extends, as written."""
        return [name for name, _ in self.extended()]

    def extended(self) -> list[tuple[str, Modifiers]]:
        """Return the classes that it extends, with modifiers."""
        clauses = [s.core[1:] for s in self.declarations if s.first == "extends"]
        return [(name, _modifiers(c[at + 1 : -1])) for c in clauses for name, at in [dotted_name(c)]]

    def derived(self) -> set[str]:
        """Return names whose derivative its equations take."""
        triples = (t for s in self.equations for t in zip(*(s.tokens[k:] for k in range(3)), strict=False))
        return {c.word for a, b, c in triples if (a.word, b.word) == ("der", "(")}

    def aliases(self) -> dict[str, str]:
        """List short class definitions, such as replaceable models, and the classes that they stand for."""
        found = {}
        for s in (s for s in self.statements if s.section == "class"):
            at = next(k for k, t in enumerate(s.tokens) if t.word == "=")
            found[s.tokens[at - 1].word] = dotted_name(s.tokens[at + 1 :])[0]
        return found

    def walk(self) -> Iterator[ClassText]:
        """Yield this class and those inside it."""
        yield self
        for inner in self.classes:
            yield from inner.walk()


def snake_case(name: str) -> str:
    """Write ``CoulombFriction`` as ``coulomb_friction``."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", name).lower()


def innermost(classes: Sequence[ClassText], at: int) -> ClassText | None:
    """Return the smallest class around a position."""
    around = [c for top in classes for c in top.walk() if c.start <= at < c.end]
    return min(around, key=lambda c: c.end - c.start, default=None)


def dotted_name(tokens: Sequence[Token]) -> tuple[str, int]:
    """Return a dotted name at the beginning and how many tokens it takes."""
    at = 1 if tokens and tokens[0].word == "." else 0
    words = []
    while at < len(tokens) and tokens[at].kind == "name":
        words.append(tokens[at].word)
        if at + 1 < len(tokens) and tokens[at + 1].word == ".":
            at += 2
        else:
            return ".".join(words), at + 1
    return ".".join(words), at


def _without_comment(tokens: Sequence[Token]) -> Sequence[Token]:
    """Return the tokens before a description or an annotation."""
    at = rest = find_outside(tokens, _ANNOTATION)
    while rest > 0 and (tokens[rest - 1].kind == "text" or tokens[rest - 1].word == "+"):
        rest -= 1
    # a text after one of these is a value
    value = rest > 0 and tokens[rest - 1].word in ("=", ":=", "==", "<>", "then", "else", "return")
    return tokens[: at if value else rest]


def _components(statement: SourceStatement) -> list[ComponentDeclaration]:
    tokens = statement.tokens
    at = 0
    prefixes = set()
    while at < len(tokens) and tokens[at].word in _VARIABLE_PREFIXES:
        prefixes.add(tokens[at].word)
        at += 1
    if at >= len(tokens) or tokens[at].word in ("extends", "import") or tokens[at].word in CLASS_WORDS:
        return []
    if statement.section == "protected":
        prefixes.add("protected")
    type_, used = dotted_name(tokens[at:])
    type_tokens = tuple(tokens[at : at + used])
    at += used
    if at < len(tokens) and tokens[at].word == "[":
        at = skip_group(tokens, at)
    found = []
    for part in split_outside(tokens[at:]):
        if not part or part[0].kind != "name":
            continue
        core = _without_comment(part)
        rest = core[1:]
        if rest and rest[0].word == "[":
            rest = rest[skip_group(rest, 0) :]
        arguments: Sequence[Token] = ()
        if rest and rest[0].word == "(":
            close = skip_group(rest, 0)
            arguments, rest = rest[:close], rest[close:]
        stop = find_outside(rest, frozenset({"if", "annotation"})) if rest[:1] and rest[0].word == "if" else len(rest)
        binding = rest[1:stop] if rest and rest[0].word in ("=", ":=") else ()
        found.append(
            ComponentDeclaration(
                part[0].word, type_, frozenset(prefixes), _modifiers(arguments[1:-1]), tuple(binding),
                _description(part[len(core) :]), statement, type_tokens, part[0], tuple(arguments),
                tuple(part[find_outside(part, _ANNOTATION) :]),
            )
        )  # fmt: skip
    return found


def _description(comment: Sequence[Token]) -> str:
    return "".join(t.word[1:-1] for t in comment[: find_outside(comment, _ANNOTATION)] if t.kind == "text")


def _modifiers(tokens: Sequence[Token]) -> Modifiers:
    found = []
    for part in split_outside(tokens):
        body = part
        while body and (body[0].word in _MODIFYING or body[0].word in CLASS_WORDS):
            body = body[1:]
        name, used = dotted_name(body)
        if used < len(body) and body[used].word == "=":
            found.append((name, tuple(body[used + 1 :])))
    return tuple(found)


def annotation_arguments(tokens: Sequence[Token], name: str) -> Mapping[str, Expression]:
    """Return the named arguments of one entry of the annotation that some tokens hold: ``Placement(...)``.

    None without it."""
    inside = tokens[find_outside(tokens, _ANNOTATION) + 2 : -1]
    for part in split_outside(inside):
        if part and part[0].word == name:
            with suppress(InputError):
                return arguments_of(parse_expression(part))
    return {}
