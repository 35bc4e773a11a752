"""Copies of the classes of components, where a law enters a balance inside one."""

from __future__ import annotations

from dataclasses import dataclass, field

from aero_bayes.errors import InputError
from aero_bayes.physics.classes import ClassText
from aero_bayes.physics.edit import Edit
from aero_bayes.physics.inline import with_bases
from aero_bayes.physics.sources import SourceFile, Sources


@dataclass
class ComponentCopy:
    """A copy of a component's class: where it comes from, what is edited in it, and what the model gives it."""

    name: str
    file: SourceFile
    origin: ClassText
    text: str
    cls: ClassText
    edits: list[Edit] = field(default_factory=list)
    declarations: list[str] = field(default_factory=list)
    inputs: dict[str, str] = field(default_factory=dict)

    def write_out_bases(self, known: Sources) -> None:
        """Have the base classes in the text, before anything is edited."""
        if self.cls.bases() and not self.edits:
            whole, self.cls = with_bases(known, self.file, self.origin)
            self.text = whole.text

    def take(self, name: str, value: str, about: str) -> None:
        """Declare an input, and bind it where the component is declared."""
        self.inputs[name] = value
        self.declarations.append(f"input Real {name} {about};")


def retyped(cls: ClassText, name: str, copy: ComponentCopy) -> list[Edit]:
    """Declare a component by the copy of its class, and give that what it takes."""
    components = cls.components()
    c = next(c for c in components if c.name == name)
    if sum(other.statement is c.statement for other in components) > 1:
        raise InputError(f"{cls.name}: declare {name!r} in a statement of its own to add a law inside it")
    given = ", ".join(f"{k} = {v}" for k, v in copy.inputs.items())
    edits = [Edit(c.type_tokens[0].start, c.type_tokens[-1].end, copy.name)]
    if c.arguments:
        comma = ", " if len(c.arguments) > 2 else ""
        return [*edits, Edit(c.arguments[-1].start, c.arguments[-1].start, comma + given)]
    return [*edits, Edit(c.name_token.end, c.name_token.end, f"({given})")]
