"""The class of the user with laws: declarations, equations and edits are collected and then applied to the text."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from aero_bayes.errors import InputError
from aero_bayes.language.base_classes import inline_base_classes, standalone_text
from aero_bayes.language.class_reader import read_classes
from aero_bayes.language.classes import ClassText, ComponentDeclaration
from aero_bayes.language.edits import (
    TextEdit,
    add_declarations,
    add_equations,
    apply_edits,
    rename_class,
    replace_names,
    text_of,
)
from aero_bayes.language.sources import SourceFile, Sources
from aero_bayes.language.tokens import Token
from aero_bayes.laws.component_copies import ComponentCopy, declare_as_copies
from aero_bayes.laws.law_text import class_text
from aero_bayes.laws.placed_law import PlacedLaw, identifier


class ClassWithLaws:
    """A class to which laws are added."""

    def __init__(
        self,
        known: Sources,
        user: tuple[SourceFile, ClassText],
        placed_laws: Sequence[PlacedLaw],
        title: str,
        *,
        inherits: bool,
    ) -> None:
        self.known, self.user, self.placed_laws, self.title = known, user, placed_laws, title
        #: names of classes that are visible in the class of the user
        self.enclosing_names = known.meanings(user[1]).keys()
        self.file, self.cls = self._own_text(inherits)
        cls = self.cls
        self.components: dict[str, ComponentDeclaration] = {c.name: c for c in cls.components()}
        self.extends = all(u.port.attachment == "node" for u in placed_laws)
        self.parameters = [line for placed in placed_laws for line in placed.declarations()]
        self.classes: list[list[str]] = []
        self.instances: dict[str, tuple[str, dict[str, str]]] = {}
        self.variables: list[str] = []
        self.equations: list[str] = []
        self.edits: list[TextEdit] = []
        #: by signal, the variable that the rest of the class reads instead; and signals that the class computes
        self.replacements: dict[str, str] = {}
        self.computed: set[str] = set()
        #: by output, and by element of an array that is read in place of inputs, the variable that it equals; the
        #: expression that an output was equal to before
        self.sources: dict[str, str] = {}
        self.moved_equations: dict[str, Sequence[Token]] = {}
        #: bindings that become equations of another variable
        self.freed_bindings: dict[str, Sequence[Token]] = {}
        self.connectors: dict[str, str] = {}
        self.copies: dict[str, ComponentCopy] = {}

    def original(self) -> str:
        """Return the class of the user as a file of its own, for a comparison."""
        return self._plain_text(*self.user)

    def _plain_text(self, file: SourceFile, cls: ClassText) -> str:
        whole = file.classes == (cls,) and not cls.within
        return file.text if whole else "within ;\n" + standalone_text(self.known, file, cls)

    def _own_text(self, inherits: bool) -> tuple[SourceFile, ClassText]:
        """Return the class of the user as a file of its own, with base classes written out if they are edited."""
        file, cls = self.user
        if inherits:
            file, _ = inline_base_classes(self.known, file, cls)
            text = "within ;\n" + file.text
        else:
            text = self._plain_text(file, cls)
        classes = read_classes(text)
        return SourceFile(file.file, text, classes), classes[0]

    # parts that every law adds

    def declare(
        self,
        placed: PlacedLaw,
        given: Mapping[str, str],
        inside: Mapping[str, str],
        declarations: Sequence[str] = (),
        equations: Sequence[str] = (),
    ) -> None:
        """Declare the class of a law and its component.

        Inputs in ``given`` are bound at the component, those in ``inside`` are variables of the class."""
        name = "".join(w[:1].upper() + w[1:] for w in placed.instance.split("_"))
        while name in self.enclosing_names or name in self.cls.class_names:
            name += "Law"
        lines = class_text(
            placed.law, name, nominals=placed.all_nominals, signals=inside,
            without=frozenset() if placed.neighbour else frozenset({"share", "q_2"}),
            declarations=declarations, equations=equations,
        )  # fmt: skip
        self.classes.append(lines)
        words = {word for line in lines for word in re.findall(r"\w+", line)}
        bound = {p.name: placed.names[p.name] for p in placed.parameters()}
        standing = {signal: f"{value:.12g}" for signal, value in placed.signal_defaults.items() if signal not in inside}
        bound |= {signal: value for signal, value in {**standing, **given}.items() if signal in words}
        self.instances[placed.instance] = name, bound

    def copy_of(self, path: str) -> ComponentCopy:
        """Return the copy of the class of a component.

        The classes of the components that contain it are copied as well."""
        if path in self.copies:
            return self.copies[path]
        parent, _, name = path.rpartition(".")
        holder = self.copy_of(parent) if parent else None
        cls = holder.cls if holder else self.cls
        if holder and name not in {c.name for c in cls.components()}:
            holder.write_out_bases(self.known)
            cls = holder.cls
        component = next((c for c in cls.components() if c.name == name), None)
        if component is None:
            raise InputError(f"{cls.name}: the component {name!r} is not declared there")
        scope = holder.origin if holder else self.user[1]
        file, origin = self.known.find(self.known.resolve(scope, component.type))
        text = standalone_text(self.known, file, origin)
        (own,) = read_classes(text)
        copy = ComponentCopy(f"{own.name}_{identifier(path)}", file, origin, text, own)
        self.copies[path] = copy
        return copy

    # the text

    def written(self) -> str:
        """Return the whole file."""
        return self._extension() if self.extends else self._copy()

    def _declarations(self) -> list[str]:
        connectors = (f"connector {name} = {what};" for name, what in self.connectors.items())
        lines = [*self.parameters, *connectors, *self.variables]
        for cls, (instance, (name, bound)) in zip(self.classes, self.instances.items(), strict=True):
            lines += [*cls, f"{name} {instance}({', '.join(f'{k} = {v}' for k, v in bound.items())});"]
        return [*lines, *self._copied_classes("")]

    def _copied_classes(self, parent: str) -> list[str]:
        """Return the lines of the copies of classes of components inside ``parent``."""
        lines: list[str] = []
        for path, copy in self.copies.items():
            if path.rpartition(".")[0] == parent:
                inner = self._copied_classes(path)
                edits = [
                    *copy.edits,
                    *rename_class(copy.cls, copy.name),
                    *self._component_types(path, copy.cls, copy.text),
                ]
                edits += add_declarations(copy.text, copy.cls, [*copy.declarations, *inner])
                lines += apply_edits(copy.text, edits).rstrip("\n").split("\n")
        return lines

    def _component_types(self, parent: str, cls: ClassText, text: str) -> list[TextEdit]:
        """Return edits that declare the components of a class by the copies of their classes."""
        own = {path.rpartition(".")[2]: c for path, c in self.copies.items() if path.rpartition(".")[0] == parent}
        return declare_as_copies(cls, own, text)

    def _description_text(self) -> str:
        added = " and ".join(
            f"{u.law.description[:1].lower()}{u.law.description[1:]} at {u.port.id}" for u in self.placed_laws
        )
        return f"{self.user[1].description or self.user[1].name}, with {added}".replace('"', "'")

    def _extension(self) -> str:
        lines = ["within ;", f'model {self.title} "{self._description_text()}"', f"  extends {self.user[1].full_name};"]
        lines += [f"  {line}" for line in self._declarations()]
        return "\n".join([*lines, "equation", *(f"  {line}" for line in self.equations), f"end {self.title};", ""])

    def _copy(self) -> str:
        text, cls = self.file.text, self.cls
        edits = [*self.edits, *rename_class(cls, self.title), self._description()]
        for name, tokens in self.moved_equations.items():
            instance = self.replacements[name].removesuffix(".u")
            self.instances[instance][1]["u"] = self._renamed(tokens)
            edits.append(TextEdit(tokens[0].start, tokens[-1].end, self.sources[name]))
        self.equations += [f"{name} = {self._renamed(tokens)};" for name, tokens in self.freed_bindings.items()]
        self.equations += [f"{name} = {y};" for name, y in self.sources.items() if name not in self.moved_equations]
        gone = [
            (tokens[0].start, tokens[-1].end)
            for tokens in (*self.moved_equations.values(), *self.freed_bindings.values())
        ]
        for tokens in self.freed_bindings.values():
            equals = text.rindex("=", 0, tokens[0].start)
            edits.append(TextEdit(equals, tokens[-1].end, ""))
        for s in cls.statements:
            names = {c.name_token.start for c in self.components.values() if c.statement is s}
            if s.section == "equation" and [t.word for t in s.core[1:2]] == ["="] and s.core[0].word in self.computed:
                names.add(s.core[0].start)
            if s.section == "equation" and s.core[:1] and s.core[0].word in self.moved_equations:
                names.add(s.core[0].start)
            edits += [
                e
                for e in replace_names(s.tokens, self.replacements.get, functions=False)
                if e.start not in names and not any(start <= e.start < end for start, end in gone)
            ]
        edits += self._component_types("", cls, text)
        edits += add_declarations(text, cls, self._declarations())
        return apply_edits(text, [*edits, *add_equations(text, cls, self.equations)])

    def _renamed(self, tokens: Sequence[Token]) -> str:
        begin = tokens[0].start
        edits = [e.moved(-begin) for e in replace_names(tokens, self.replacements.get, functions=False)]
        return apply_edits(text_of(self.file.text, tokens), edits)

    def _description(self) -> TextEdit:
        head = self.cls.name_token.end
        return TextEdit(head, self.cls.body if self.cls.description else head, f' "{self._description_text()}"')
