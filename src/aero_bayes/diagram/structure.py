"""A model as the tree of its components, with inheritance and redeclarations carried out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from aero_bayes.diagram.source import Call, Class, Library, Link, Part

_DEEPEST = 12


@dataclass
class Tree:
    """A class with what it inherits. ``inside`` holds the trees of those components whose class is known."""

    name: str
    description: str = ""
    parts: dict[str, Part] = field(default_factory=dict)
    inside: dict[str, Tree] = field(default_factory=dict)
    links: list[Link] = field(default_factory=list)
    icon: list[Call] = field(default_factory=list)
    aliases: dict[str, str] = field(default_factory=dict)

    def same_as(self, other: Tree | None) -> bool:
        """Whether both are made of the same components of the same classes."""
        return (
            other is not None
            and self.name == other.name
            and self.parts.keys() == other.parts.keys()
            and all(tree.same_as(other.inside.get(name)) for name, tree in self.inside.items())
        )


def grow(library: Library, name: str, given: Mapping[str, str] | None = None, depth: int = 0) -> Tree:
    """The tree of a class; ``given`` are the full names of redeclared classes.

    Raises
    ------
    KeyError
        The library has no such class.
    """
    found, given = library[name], given or {}
    tree = Tree(name, found.description)
    for base in found.bases:
        full = look_up(library, base.name, name)
        if full is not None and depth < _DEEPEST:
            inherited = grow(library, full, _redeclared(library, base, tree.aliases, name) | dict(given), depth + 1)
            tree.parts |= inherited.parts
            tree.inside |= inherited.inside
            tree.links += inherited.links
            tree.icon += inherited.icon
            tree.aliases |= inherited.aliases
    for alias, target in found.aliases.items():
        tree.aliases[alias] = look_up(library, target, name) or target
    tree.aliases |= {alias: full for alias, full in given.items() if alias in tree.aliases}
    for part in found.parts:
        tree.parts[part.name] = part
        full = tree.aliases.get(part.type) or look_up(library, part.type, name)
        if full in library and library[full].kind not in {"type", "connector"} and depth < _DEEPEST:
            tree.inside[part.name] = grow(
                library, full, _redeclared(library, part.modifiers, tree.aliases, name), depth + 1
            )
    tree.links += found.links
    tree.icon += _graphics(found)
    return tree


def look_up(library: Library, name: str, scope: str) -> str | None:
    """Full name of a class as seen from within another, by Modelica's rule: from the inside outwards."""
    if name.startswith("."):
        return name[1:] if name[1:] in library else None
    parts = scope.split(".")
    return next(
        (full for size in range(len(parts), -1, -1) if (full := ".".join([*parts[:size], name])) in library), None
    )


def _redeclared(library: Library, modifiers: Call, aliases: Mapping[str, str], scope: str) -> dict[str, str]:
    pairs = {key: value for key, value in modifiers.keys.items() if isinstance(value, str)}
    full = {key: aliases.get(value) or look_up(library, value, scope) for key, value in pairs.items()}
    return {key: name for key, name in full.items() if name is not None}


def _graphics(found: Class) -> list[Call]:
    icon = found.annotation.find("Icon")
    drawn = icon.keys.get("graphics") if icon is not None else None
    return [item for item in drawn if isinstance(item, Call)] if isinstance(drawn, list) else []
