"""Which parameters a user's own sources declare or set, and which are defaults of a library's classes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from aero_bayes.language.classes import ClassText, ComponentDeclaration
from aero_bayes.language.tokens import Token, without_indices


class OwnClasses:
    """The classes of the user's sources."""

    def __init__(self, classes: Sequence[ClassText], model: str) -> None:
        self.by_name = {c.full_name.rpartition(".")[2]: c for c in classes}
        self.top = next((c for c in classes if c.full_name == model), None)

    def sets(self, parameter: str) -> bool:
        """Tell whether a class of the user's declares a parameter, or gives it a value."""
        if self.top is None:
            return True
        *path, name = without_indices(parameter).split(".")
        cls: ClassText | None = self.top
        around: list[ComponentDeclaration] = []
        for part in path:
            held = self._component(cls, part)
            if held is None:
                return any(_sets(c.arguments, name) for c in around)
            around.append(held)
            cls = self.by_name.get(held.type.rpartition(".")[2])
        declared = self._component(cls, name) is not None
        return declared or any(_sets(c.arguments, name) for c in around) or self._set_by_extends(cls, name)

    def _lines(self, cls: ClassText | None) -> list[ClassText]:
        """Return a class and its base classes, those that are the user's."""
        if cls is None:
            return []
        bases = (self.by_name.get(b.rpartition(".")[2]) for b in cls.bases())
        return [cls, *(inner for b in bases if b is not cls for inner in self._lines(b))]

    def _component(self, cls: ClassText | None, name: str) -> ComponentDeclaration | None:
        return next((c for k in self._lines(cls) for c in k.components() if c.name == name), None)

    def _set_by_extends(self, cls: ClassText | None, name: str) -> bool:
        clauses = (s for k in self._lines(cls) for s in k.declarations if s.first == "extends")
        return any(_sets(s.core, name) for s in clauses)


def _sets(tokens: Sequence[Token], name: str) -> bool:
    return any(one.word == name and two.word == "=" for one, two in pairwise(tokens))
