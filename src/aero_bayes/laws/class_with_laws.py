"""The class of the user with laws: declarations, equations and edits are collected and then applied to the text."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from aero_bayes.errors import InputError
from aero_bayes.laws.candidates import PlacedLaw, describe_law, identifier
from aero_bayes.laws.law import SIGNAL_DEFAULTS, Law
from aero_bayes.laws.wiring import Read, wiring
from aero_bayes.modelica.class_reader import read_classes
from aero_bayes.modelica.classes import ClassText, ComponentDeclaration, SourceStatement
from aero_bayes.modelica.edits import (
    TextEdit,
    add_declarations,
    add_equations,
    apply_edits,
    indentation,
    rename_class,
    replace_names,
    text_of,
)
from aero_bayes.modelica.parse import (
    Token,
    evaluate_expression,
    one_line,
    parse_expression,
    parse_text,
    skip_group,
    words_of,
)
from aero_bayes.modelica.sources import SourceFile, Sources, inline_base_classes, standalone_text
from aero_bayes.modelica.syntax import Name, map_names, modelica_text, parse_reference, short_text, summands


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


def class_text(
    law: Law,
    name: str,
    *,
    nominals: Mapping[str, float],
    signals: Mapping[str, str],
    without: frozenset[str] = frozenset(),
    declarations: Sequence[str] = (),
    equations: Sequence[str] = (),
) -> list[str]:
    """Return the lines of a model ``name`` that is the law."""
    text, cls = law.text, law.cls
    found: dict[str, list[str]] = {"public": [], "protected": [], "initial equation": [], "equation": [*equations]}
    kept = [s for s in cls.statements if s.section in found and without.isdisjoint(words_of(s.tokens))]
    used = Counter(word for s in kept for word in {t.word for t in s.tokens if t.kind == "name"})
    for s in kept:
        components = cls.declared_in(s)
        if components and not any(used[c.name] > 1 or c.name == law.interface.output for c in components):
            continue
        edits = _edits(s, components, nominals, signals)
        # a required unit of a law is that of the port, where it may be spelled otherwise
        asked = [c.arguments for c in components if c.name in law.required_units and c.arguments]
        edits += [TextEdit(tokens[0].start, tokens[-1].end, "") for tokens in asked]
        found[s.section].append(one_line(apply_edits(text[s.start : s.end], [e.moved(-s.start) for e in edits])))
    lines = [f'model {name} "{law.description}"', *(f"  {line}" for line in (*declarations, *found.pop("public")))]
    for section, inside in found.items():
        lines += [section, *(f"  {line}" for line in inside)] if inside else []
    return [*lines, *(f"  {line}" for line in _documentation(law)), f"end {name};"]


def formula(law: Law, *, nominals: Mapping[str, float], names: Mapping[str, str]) -> str | None:
    """Return the output of a law as one expression, if its class has a single explicit equation."""
    if len(law.cls.equations) != 1:
        return None
    (equation,) = law.cls.equations
    core = equation.core
    if [t.word for t in core[:2]] != [law.interface.output, "="] or any(t.word == "der" for t in core):
        return None
    values = {k: float(v) for k, v in nominals.items()}
    for c in law.cls.components():
        if "final" in c.prefixes:
            values[c.name] = evaluate_expression(parse_expression(c.binding), values)
        elif c.name not in (*names, *nominals, *law.interface.inputs, law.interface.output):
            return None
    numbers = {k: f"{v:.12g}" if v >= 0.0 else f"({v:.12g})" for k, v in values.items()}
    known = {
        **numbers,
        **{signal: numbers[nominal] for signal, nominal in SIGNAL_DEFAULTS.items() if nominal in numbers},
        **names,
    }
    edits = [e.moved(-core[2].start) for e in replace_names(core[2:], known.get)]
    text = re.sub(r"- \(-([\w.]+)\)", r"+ \1", one_line(apply_edits(text_of(law.text, core[2:]), edits)))
    text = re.sub(r"(?<!\w)\(([\w.]+) - 0\)", r"\1", text)
    text = re.sub(r"\(([\w.]+) - 0\)", r"(\1)", text)
    tree = parse_text(text)
    return text if summands(tree) == [(1, tree)] else f"({text})"


def _edits(
    statement: SourceStatement,
    components: Sequence[ComponentDeclaration],
    nominals: Mapping[str, float],
    signals: Mapping[str, str],
) -> list[TextEdit]:
    """Return edits that set nominal values and inputs in a declaration."""
    edits: list[TextEdit] = []
    # nominal values, and final parameters that follow from them, are not to be tuned
    if any(c.name in nominals or "final" in c.prefixes for c in components):
        first = next(t for t in statement.tokens if t.word in ("final", "parameter"))
        last = next(t for t in statement.tokens if t.word == "parameter")
        edits.append(TextEdit(first.start, last.end, "constant"))
    for c in components:
        value = signals.get(c.name, repr(float(nominals[c.name])) if c.name in nominals else None)
        if value is None:
            continue
        if c.name in signals:
            word = next(t for t in statement.tokens if t.word == "input")
            edits.append(TextEdit(word.start, word.end + 1, ""))
        if c.binding:
            edits.append(TextEdit(c.binding[0].start, c.binding[-1].end, value))
        else:
            end = (c.arguments[-1] if c.arguments else c.name_token).end
            edits.append(TextEdit(end, end, f" = {value}"))
    return edits


def _documentation(law: Law) -> list[str]:
    if not law.cls.annotation:
        return []
    indent = indentation(law.text, law.cls.annotation_start)
    lines = text_of(law.text, law.cls.annotation).split("\n")
    return [line.removeprefix(indent) for line in lines[:-1]] + [lines[-1].removeprefix(indent) + ";"]


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
        self.inherits = inherits
        self.wires = {wired.law.instance: wired for wired in wiring(placed_laws)}
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

    def called(self, read: Read) -> str:
        """Return what an input of a law is in the text, beside laws at inputs and outputs."""
        if read.after is not None:
            return f"{read.after.instance}.{read.after.law.interface.output}"
        # a reading that is a state has a name of its own for what it was
        outputs = {str(p.port.acted_on) for p in self.placed_laws if p.port.attachment == "output"}

        def inner(n: Name) -> Name:
            name = short_text(n)
            if read.raw and name not in outputs:
                return n
            # an array whose elements have laws is replaced as a whole
            whole = replace(n, name=self.replacements.get(n.name, n.name))
            return parse_reference(self.replacements[name]) if name in self.replacements else whole

        return modelica_text(map_names(read.signal.expression, inner), 2) or str(read.signal)

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
        bound = {p.name: placed.names[p.name] for p in placed.parameters()}
        standing = {signal: f"{value:.12g}" for signal, value in placed.signal_defaults.items() if signal not in inside}
        bound |= {signal: value for signal, value in {**standing, **given}.items() if signal in placed.law.used_inputs}
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
        added = " and ".join(describe_law(u.law, u.port) for u in self.placed_laws)
        return f"{self.user[1].description or self.user[1].name}, with {added}".replace('"', "'")

    def _extension(self) -> str:
        lines = ["within ;", f'model {self.title} "{self._description_text()}"', f"  extends {self.user[1].full_name};"]
        lines += [f"  {line}" for line in self._declarations()]
        return "\n".join([*lines, "equation", *(f"  {line}" for line in self.equations), f"end {self.title};", ""])

    def _copy(self) -> str:
        text, cls = self.file.text, self.cls
        for name, tokens in self.moved_equations.items():
            instance = self.replacements[name].removesuffix(".u")
            self.instances[instance][1]["u"] = self._renamed(tokens)
        self.equations += [f"{name} = {self._renamed(tokens)};" for name, tokens in self.freed_bindings.items()]
        self.equations += [f"{name} = {y};" for name, y in self.sources.items() if name not in self.moved_equations]
        gone = [(t[0].start, t[-1].end) for t in (*self.moved_equations.values(), *self.freed_bindings.values())]
        # what is added to an expression moves with it
        edits = [e for e in self.edits if not any(start <= e.start and e.end <= end for start, end in gone)]
        edits += [*rename_class(cls, self.title), self._description()]
        edits += [TextEdit(t[0].start, t[-1].end, self.sources[name]) for name, t in self.moved_equations.items()]
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
        begin, end = tokens[0].start, tokens[-1].end
        edits = [*replace_names(tokens, self.replacements.get, functions=False)]
        edits += [e for e in self.edits if begin <= e.start and e.end <= end]
        return apply_edits(text_of(self.file.text, tokens), [e.moved(-begin) for e in edits])

    def _description(self) -> TextEdit:
        head = self.cls.name_token.end
        return TextEdit(head, self.cls.body if self.cls.description else head, f' "{self._description_text()}"')
