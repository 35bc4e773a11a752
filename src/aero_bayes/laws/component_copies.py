"""Copies of the classes of components, for laws that enter a balance inside a component."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from aero_bayes.language.base_classes import inline_base_classes
from aero_bayes.language.classes import ClassText, ComponentDeclaration
from aero_bayes.language.edits import TextEdit, indentation, text_of
from aero_bayes.language.sources import SourceFile, Sources
from aero_bayes.language.tokens import skip_group


@dataclass
class ComponentCopy:
    """A copy of the class of a component, with edits.

    ``origin`` is the original class in ``file``; ``text`` and ``cls`` are the copy. ``inputs`` are new inputs with
    their bindings at the component."""

    name: str
    file: SourceFile
    origin: ClassText
    text: str
    cls: ClassText
    edits: list[TextEdit] = field(default_factory=list)
    declarations: list[str] = field(default_factory=list)
    inputs: dict[str, str] = field(default_factory=dict)

    def write_out_bases(self, known: Sources) -> None:
        """Write the base classes out in the text, unless that is done or something is edited already."""
        if self.cls.bases() and not self.edits:
            whole, self.cls = inline_base_classes(known, self.file, self.origin)
            self.text = whole.text

    def add_input(self, name: str, value: str, about: str) -> None:
        """Declare an input, and bind it to a value where the component is declared."""
        self.inputs[name] = value
        self.declarations.append(f"input Real {name} {about};")


def without_indices(path: str) -> tuple[str, dict[str, int]]:
    """Return the path of a component without array indices, and the indices by the paths of the arrays."""
    plain, numbers = "", dict[str, int]()
    for part in path.split("."):
        name, _, number = part.partition("[")
        plain = f"{plain}.{name}" if plain else name
        if number[:-1].isdigit():
            numbers[plain] = int(number[:-1])
    return plain, numbers


def declare_as_copies(cls: ClassText, copies: Mapping[str, ComponentCopy], text: str) -> list[TextEdit]:
    """Return edits that declare components by the copies of their classes, and bind the new inputs of these."""
    edits: list[TextEdit] = []
    for statement in cls.declarations:
        together = cls.declared_in(statement)
        if any(c.name in copies for c in together):
            edits += _types(together, copies, text)
            edits += [e for c in together if c.name in copies for e in _arguments(c, copies[c.name])]
    return edits


def _types(together: Sequence[ComponentDeclaration], copies: Mapping[str, ComponentCopy], text: str) -> list[TextEdit]:
    """Return edits of the types in one declaration. Where it declares several components, it is split."""
    first, *others = together
    own = {c.name: copies[c.name].name if c.name in copies else text_of(text, c.type_tokens) for c in together}
    tokens = first.statement.tokens
    prefix = text[tokens[0].start : first.type_tokens[0].start]
    edits = [TextEdit(first.type_tokens[0].start, first.type_tokens[-1].end, own[first.name])]
    for c in others:
        comma = tokens[tokens.index(c.name_token) - 1]
        begin = f";\n{indentation(text, tokens[0].start)}{prefix}{own[c.name]} "
        edits.append(TextEdit(comma.start, c.name_token.start, begin))
    return edits


def _arguments(c: ComponentDeclaration, copy: ComponentCopy) -> list[TextEdit]:
    given = ", ".join(f"{k} = {v}" for k, v in copy.inputs.items())
    if not c.arguments:
        tokens = c.statement.tokens
        after = tokens.index(c.name_token) + 1
        if after < len(tokens) and tokens[after].word == "[":
            after = skip_group(tokens, after)
        return [TextEdit(tokens[after - 1].end, tokens[after - 1].end, f"({given})")]
    comma = ", " if len(c.arguments) > 2 else ""
    return [TextEdit(c.arguments[-1].start, c.arguments[-1].start, comma + given)]
