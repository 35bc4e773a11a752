"""A model as the tree of its components, with inheritance and redeclarations carried out."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

from aero_bayes.errors import InputError
from aero_bayes.modelica.classes import (
    CLASS_WORDS,
    ClassText,
    ComponentDeclaration,
    Modifiers,
    SourceStatement,
    annotation_arguments,
    dotted_name,
)
from aero_bayes.modelica.parse import (
    Token,
    find_outside,
    line_of,
    sides_of,
    skip_group,
    tokenize,
    without_indices,
    words_of,
)
from aero_bayes.modelica.syntax import Array, Expression, Name

_CLASS_PREFIXES = frozenset(
    {"encapsulated", "partial", "final", "inner", "outer", "replaceable", "redeclare", "expandable", "pure", "impure"}
)
_COMPOUND = frozenset({"if", "for", "when", "while"})


@lru_cache(maxsize=1024)  # the same text is read at several stages; nobody changes the result
def read_classes(text: str) -> tuple[ClassText, ...]:
    """Return the classes of one file, outermost ones. Raises InputError, with the line, for what is not Modelica."""
    reader = _ClassReader(tokenize(text), text)
    return tuple(reader.file())


class _ClassReader:
    def __init__(self, tokens: tuple[Token, ...], text: str) -> None:
        self.tokens = tokens
        self.text = text
        self.at = 0

    def word(self, ahead: int = 0) -> str:
        at = self.at + ahead
        return self.tokens[at].word if at < len(self.tokens) and self.tokens[at].kind != "text" else ""

    def fail(self, why: str) -> InputError:
        at = self.tokens[self.at].start if self.at < len(self.tokens) else len(self.text)
        return InputError(f"line {line_of(self.text, at)}: {why}")

    def file(self) -> Iterator[ClassText]:
        within = ""
        while self.at < len(self.tokens):
            if self.word() == "within":
                end = self.semicolon()
                within = "".join(t.word for t in self.tokens[self.at + 1 : end])
                self.at = end + 1
            elif self.class_head() is not None:
                found = self.class_(within)
                if found is not None:
                    yield found
            else:
                raise self.fail("expected a class")

    def semicolon(self) -> int:
        end = find_outside(self.tokens, frozenset({";"}), self.at)
        if end >= len(self.tokens):
            raise self.fail("a semicolon is missing")
        return end

    def class_head(self) -> int | None:
        """Return the index of the class's name where a class begins here."""
        at = self.at
        while at < len(self.tokens) and self.tokens[at].word in _CLASS_PREFIXES:
            at += 1
        if at >= len(self.tokens) or self.tokens[at].word not in CLASS_WORDS or self.tokens[at].kind != "name":
            return None
        while at < len(self.tokens) and self.tokens[at].word in CLASS_WORDS:
            at += 1
        if at < len(self.tokens) and self.tokens[at].word == "extends":
            at += 1
        return at if at < len(self.tokens) and self.tokens[at].kind == "name" else None

    def class_(self, within: str) -> ClassText | None:
        """Return a class with a body; a short one is passed over."""
        first = self.tokens[self.at]
        at = self.class_head()
        assert at is not None
        name = self.tokens[at]
        kind = next(t.word for t in self.tokens[self.at : at] if t.word in CLASS_WORDS)
        partial = any(t.word == "partial" for t in self.tokens[self.at : at])
        if at + 1 < len(self.tokens) and self.tokens[at + 1].word == "=":
            self.at = self.semicolon() + 1
            return None
        self.at = at + 1
        if self.word() == "(":
            self.at = skip_group(self.tokens, self.at)
        description = ""
        while self.at < len(self.tokens) and self.tokens[self.at].kind == "text":
            description += self.tokens[self.at].word[1:-1]
            self.at += 1
            if self.word() == "+":
                self.at += 1
        cls = ClassText(kind, name.word, first.start, self.tokens[self.at - 1].end, name, within, description)
        cls.partial = partial
        self.body(cls)
        return cls

    def body(self, cls: ClassText) -> None:
        section, opened = "public", cls.body
        while True:
            if self.at >= len(self.tokens):
                raise self.fail(f"the end of {cls.name!r} is missing")
            word, here = self.word(), self.tokens[self.at].start
            if word == "end":
                cls.sections.append((section, opened, here))
                cls.close = here
                cls.end_name = self.tokens[self.at + 1] if self.at + 1 < len(self.tokens) else None
                end = self.semicolon()
                self.at = end + 1
                cls.end = self.tokens[end].end
                return
            initial = word == "initial" and self.word(1) in ("equation", "algorithm")
            if word in ("public", "protected", "equation", "algorithm") or initial:
                cls.sections.append((section, opened, here))
                section = f"initial {self.word(1)}" if initial else word
                self.at += 2 if initial else 1
                opened = self.tokens[self.at - 1].end
            elif word == "annotation":
                end = self.semicolon()
                cls.annotation, cls.annotation_start = self.tokens[self.at : end], here
                self.at = end + 1
            elif section in ("public", "protected") and self.class_head() is not None:
                at = self.class_head()
                assert at is not None
                cls.class_names.append(self.tokens[at].word)
                begin = self.at
                inner = self.class_(cls.full_name)
                if inner is not None:
                    cls.classes.append(inner)
                else:
                    tokens = self.tokens[begin : self.at - 1]
                    cls.statements.append(SourceStatement("class", tokens, here, self.tokens[self.at - 1].end))
            elif section in ("public", "protected") or word == "external":
                self.simple(cls, section)
            else:
                self.equation(cls, section)

    def simple(self, cls: ClassText, section: str, inside: tuple[str, ...] = (), head: tuple[Token, ...] = ()) -> None:
        end = self.semicolon()
        tokens = self.tokens[self.at : end]
        if tokens:
            cls.statements.append(SourceStatement(section, tokens, tokens[0].start, self.tokens[end].end, inside, head))
        self.at = end + 1

    def equation(
        self, cls: ClassText, section: str, inside: tuple[str, ...] = (), head: tuple[Token, ...] = ()
    ) -> None:
        opening = self.word()
        if opening not in _COMPOUND:
            self.simple(cls, section, inside, head)
            return
        begin = self.at
        self.condition()
        head = self.tokens[begin : self.at]
        while True:
            word = self.word()
            if word == "end" and self.word(1) == opening:
                self.at = self.semicolon() + 1
                return
            if word in ("elseif", "elsewhen"):
                self.condition()
            elif word == "else":
                self.at += 1
            elif self.at >= len(self.tokens) or word == "end":
                raise self.fail(f"the end of {opening!r} is missing")
            else:
                self.equation(cls, section, (*inside, opening), head)

    def condition(self) -> None:
        """Skip the head of a compound equation; an if-expression in it brings a ``then`` of its own."""
        self.at += 1
        open_ifs = 0
        while self.at < len(self.tokens):
            word = self.word()
            if word in ("if", "elseif"):
                open_ifs += 1
            elif word in ("then", "loop"):
                if not open_ifs:
                    self.at += 1
                    return
                open_ifs -= 1
            self.at = skip_group(self.tokens, self.at) if word and word in "([{" else self.at + 1
        raise self.fail("'then' or 'loop' is missing")


_DEEPEST = 12

#: Classes by their full names.
ClassLibrary = Mapping[str, ClassText]


@dataclass(frozen=True)
class Connection:
    """``connect(first, second)``, or an equation ``first = second`` of two names; ``line`` is how it is drawn."""

    first: str
    second: str
    line: Mapping[str, Expression]


@dataclass
class ComponentTree:
    """A class with what it inherits. ``inside`` holds the trees of those components whose class is known."""

    name: str
    description: str = ""
    parts: dict[str, ComponentDeclaration] = field(default_factory=dict)
    inside: dict[str, ComponentTree] = field(default_factory=dict)
    links: list[Connection] = field(default_factory=list)
    icon: list[Expression] = field(default_factory=list)
    aliases: dict[str, str] = field(default_factory=dict)
    modified: set[str] = field(default_factory=set)

    def sets(self, parameter: str) -> bool:
        """Return whether one of its classes declares a parameter, or gives it a value."""
        *path, name = without_indices(parameter).split(".")
        tree: ComponentTree | None = self
        given = set[str]()
        for part in path:
            held = tree.parts.get(part) if tree is not None else None
            if tree is None or held is None:
                return name in given
            given |= _set_in(held.arguments)
            tree = tree.inside.get(part)
        return name in given or (tree is not None and (name in tree.parts or name in tree.modified))

    def same_as(self, other: ComponentTree | None) -> bool:
        """Return whether both are made of the same components of the same classes."""
        return (
            other is not None
            and self.name == other.name
            and self.parts.keys() == other.parts.keys()
            and all(tree.same_as(other.inside.get(name)) for name, tree in self.inside.items())
        )


def read_library(files: Iterable[Path]) -> ClassLibrary:
    """Return all classes with a body of Modelica files; a file that cannot be read has none."""
    library: dict[str, ClassText] = {}
    for path in files:
        with suppress(InputError):
            tops = read_classes(path.read_text(encoding="utf-8", errors="replace"))
            library |= {c.full_name: c for top in tops for c in top.walk()}
    return library


def build_tree(
    library: ClassLibrary, name: str, given: Mapping[str, str] | None = None, depth: int = 0
) -> ComponentTree:
    """Return the tree of a class; ``given`` are the full names of redeclared classes."""
    found, given = library[name], given or {}
    tree = ComponentTree(name, found.description)
    for base, modifiers in found.extended():
        full = look_up(library, base, name)
        if full is not None and depth < _DEEPEST:
            inherited = build_tree(
                library, full, _redeclared(library, modifiers, tree.aliases, name) | dict(given), depth + 1
            )
            tree.parts |= inherited.parts
            tree.modified |= inherited.modified
            tree.inside |= inherited.inside
            tree.links += inherited.links
            tree.icon += inherited.icon
            tree.aliases |= inherited.aliases
    for alias, target in found.aliases().items():
        tree.aliases[alias] = look_up(library, target, name) or target
    tree.aliases |= {alias: full for alias, full in given.items() if alias in tree.aliases}
    for part in found.components():
        tree.parts[part.name] = part
        full = tree.aliases.get(part.type) or look_up(library, part.type, name)
        if (
            full is not None
            and full in library
            and library[full].kind not in {"type", "connector"}
            and depth < _DEEPEST
        ):
            inner = _redeclared(library, part.modifiers, tree.aliases, name)
            tree.inside[part.name] = build_tree(library, full, inner, depth + 1)
    tree.modified |= {name for s in found.declarations if s.first == "extends" for name in _set_in(s.core)}
    tree.links += [link for s in found.equations if (link := _link(s)) is not None]
    drawn = annotation_arguments(found.annotation, "Icon").get("graphics")
    tree.icon += drawn.items if isinstance(drawn, Array) else ()
    return tree


def look_up(library: ClassLibrary, name: str, scope: str) -> str | None:
    """Find the full name of a class as seen from within another, by Modelica's rule: from the inside outwards."""
    parts = scope.split(".")
    return next(
        (full for size in range(len(parts), -1, -1) if (full := ".".join([*parts[:size], name])) in library), None
    )


def _redeclared(library: ClassLibrary, modifiers: Modifiers, aliases: Mapping[str, str], scope: str) -> dict[str, str]:
    names = {key: dotted_name(value)[0] for key, value in modifiers}
    full = {key: aliases.get(name) or look_up(library, name, scope) for key, name in names.items() if name}
    return {key: name for key, name in full.items() if name is not None}


def _set_in(tokens: Sequence[Token]) -> set[str]:
    """Return the names to which a modifier gives a value."""
    return {one.word for one, two in pairwise(tokens) if two.word == "="}


def _link(s: SourceStatement) -> Connection | None:
    if s.ends:
        one, other = ("".join(words_of(end)) for end in s.ends)
        return Connection(one, other, annotation_arguments(s.tokens, "Line"))
    match sides_of(s.core):
        case Name(given, ()), Name(value, ()):
            return Connection(value, given, {})
    return None
