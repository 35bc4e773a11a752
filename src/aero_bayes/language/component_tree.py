"""A model as the tree of its components, with inheritance and redeclarations carried out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from aero_bayes.errors import InputError
from aero_bayes.language.class_reader import read_classes
from aero_bayes.language.classes import (
    ClassText,
    ComponentDeclaration,
    Modifiers,
    SourceStatement,
    annotation_arguments,
    dotted_name,
)
from aero_bayes.language.parse import sides_of
from aero_bayes.language.syntax import Array, Expression, Name
from aero_bayes.language.tokens import words_of

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


def _link(s: SourceStatement) -> Connection | None:
    if s.ends:
        one, other = ("".join(words_of(end)) for end in s.ends)
        return Connection(one, other, annotation_arguments(s.tokens, "Line"))
    match sides_of(s.core):
        case Name(given, ()), Name(value, ()):
            return Connection(value, given, {})
    return None
