"""The text of a user's class with laws in it."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from aero_bayes.errors import InputError
from aero_bayes.export.flat import FlatEquation, FlatModel
from aero_bayes.physics.balance import Entry, entry_of, sides_of
from aero_bayes.physics.classes import ClassText, Component, Statement, read_classes
from aero_bayes.physics.edit import (
    Edit,
    add_declarations,
    add_equations,
    apply,
    insert_in_connect,
    rename_class,
    replace_names,
)
from aero_bayes.physics.entrance import parameter_values
from aero_bayes.physics.inline import alone, with_bases
from aero_bayes.physics.law_class import class_text, formula
from aero_bayes.physics.ports import Port, driver_names, is_driver
from aero_bayes.physics.sources import SourceFile, Sources
from aero_bayes.physics.structure import structure_of
from aero_bayes.physics.terms import Term, parse_term
from aero_bayes.physics.tokens import Token, split_outside
from aero_bayes.physics.use import Use, plain_name

#: A law whose formula is longer than this is written as a component.
LONGEST_FORMULA = 70


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


class Writer:
    """Gathers what each law brings: declarations, equations, edits of what is there."""

    def __init__(
        self, known: Sources, file: SourceFile, cls: ClassText, flat: FlatModel, uses: Sequence[Use], title: str
    ) -> None:
        self.known, self.user, self.flat, self.uses, self.title = known, (file, cls), flat, uses, title
        self.structure = structure_of(flat)
        #: names that classes have around the user's
        self.around = known.meanings(cls).keys()
        self.file, self.cls = self._own_text()
        cls = self.cls
        self.components: dict[str, Component] = {c.name: c for c in cls.components()}
        self.extends = all(u.port.via == "node" for u in uses)
        self.parameters: list[str] = []
        self.classes: list[list[str]] = []
        self.instances: dict[str, tuple[str, dict[str, str]]] = {}
        self.variables: list[str] = []
        self.equations: list[str] = []
        self.edits: list[Edit] = []
        #: what the rest of the class reads in place of a signal
        self.read: dict[str, str] = {}
        #: outermost law of each output, and where the expression stood that it is given
        self.outputs: dict[str, str] = {}
        self.moved: dict[str, Sequence[Token]] = {}
        self.copies: dict[str, ComponentCopy] = {}

    def text(self) -> str:
        """The whole file."""
        ways: Mapping[str, Callable[[Use], None]] = {
            "input": self._at_input, "output": self._at_output, "equation": self._in_equation,
            "node": self._at_node, "series": self._in_series,
        }  # fmt: skip
        for use in self.uses:
            self._parameters(use)
        for use in sorted(self.uses, key=lambda u: u.port.via != "output"):
            ways[use.port.via](use)
        return self._extension() if self.extends else self._copy()

    def original(self) -> str:
        """The user's class as a file of its own, to compare with."""
        return self._plain_text(*self.user)

    def _plain_text(self, file: SourceFile, cls: ClassText) -> str:
        whole = file.classes == (cls,) and not cls.within
        return file.text if whole else "within ;\n" + alone(self.known, file, cls)

    def _own_text(self) -> tuple[SourceFile, ClassText]:
        """The user's class as a file of its own, with its base classes written out where they are to be edited."""
        file, cls = self.user
        if self._inherits():
            file, _ = with_bases(self.known, file, cls)
            text = "within ;\n" + file.text
        else:
            text = self._plain_text(file, cls)
        classes = read_classes(text)
        return SourceFile(file.file, text, classes), classes[0]

    # what every law brings

    def _parameters(self, use: Use) -> None:
        for p in use.parameters():
            attributes = [f'unit = "{use.unit(p)}"'] if use.unit(p) else []
            attributes += [f"{k} = {v:.6g}" for k, v in use.limits(p).items()]
            self.parameters.append(
                f"parameter Real {use.names[p.name]}({', '.join(attributes)}) = {use.value(p)!r} "
                f'"{p.description} at {use.port.id}";'
            )

    def _component(
        self,
        use: Use,
        given: Mapping[str, str],
        inside: Mapping[str, str],
        declarations: Sequence[str] = (),
        equations: Sequence[str] = (),
    ) -> None:
        """Declare the law's class and its component; ``given`` are bound at the component, ``inside`` in the class."""
        name = "".join(w[:1].upper() + w[1:] for w in use.instance.split("_"))
        while name in self.around or name in self.cls.short:
            name += "Law"
        lines = class_text(
            use.law, name, sizes=use.all_sizes, signals=inside,
            without=frozenset() if use.neighbour else frozenset({"share", "q_2"}),
            declarations=declarations, equations=equations,
        )  # fmt: skip
        self.classes.append(lines)
        words = {word for line in lines for word in re.findall(r"\w+", line)}
        bound = {p.name: use.names[p.name] for p in use.parameters()}
        bound |= {signal: value for signal, value in given.items() if signal in words}
        self.instances[use.instance] = name, bound

    # balances

    def _in_equation(self, use: Use) -> None:
        given, exchange = dict(use.port.signals), use.law.kind == "exchange"
        if exchange and use.neighbour is not None:
            given = {"h_1": use.port.signals["h"], "h_2": use.neighbour.signals["h"]}
        # a reading that is a state has a name of its own for what it was
        given = {signal: self.read.get(name, name) for signal, name in given.items()}
        near = all(not self._equation_of(p).component for p in (use.port, use.neighbour) if p is not None)
        text = formula(use.law, sizes=use.all_sizes, names={**given, **use.names}) if near else None
        if text is None or len(text) > LONGEST_FORMULA:
            self._component(use, given, {})
            text = f"{use.instance}.{use.law.shape.acts}"
        self._term(use.port, text, 1)
        if use.neighbour is not None:
            self._term(use.neighbour, text if exchange else f"{use.instance}.q_2", -1)

    def _term(self, port: Port, text: str, sign: int) -> None:
        """Append a term to the balance of a port, in the class itself or in a copy of its component's class."""
        equation = self._equation_of(port)
        if not equation.component:
            self.edits += self._entry(port, self.cls, "").insert(text, sign)
            return
        copy = self._copy_of(equation.component)
        stated = self._class_at(equation)
        if stated is None or stated.name != copy.origin.name:
            copy.write_out_bases(self.known)
        given = plain_name(text)
        copy.edits += self._entry(port, copy.cls, equation.component + ".").insert(given, sign)
        about = f'"{"Taken from" if sign > 0 else "Added to"} the balance"'
        path = equation.component
        while path:
            parent = path.rpartition(".")[0]
            self.copies[path].take(given, text if not parent else given, about)
            path = parent

    def _copy_of(self, path: str) -> ComponentCopy:
        """The copy of a component's class, and of the classes of what holds it."""
        if path in self.copies:
            return self.copies[path]
        parent, _, name = path.rpartition(".")
        holder = self._copy_of(parent) if parent else None
        cls = holder.cls if holder else self.cls
        if holder and name not in {c.name for c in cls.components()}:
            holder.write_out_bases(self.known)
            cls = holder.cls
        component = next((c for c in cls.components() if c.name == name), None)
        if component is None:
            raise InputError(f"{cls.name}: the component {name!r} is not declared there")
        scope = holder.origin if holder else self.user[1]
        file, origin = self.known.find(self.known.resolve(scope, component.type))
        text = alone(self.known, file, origin)
        (own,) = read_classes(text)
        copy = ComponentCopy(f"{own.name}_{plain_name(path)}", file, origin, text, own)
        self.copies[path] = copy
        return copy

    def _equation_of(self, port: Port) -> FlatEquation:
        if port.entrance is None:
            raise InputError(f"the port {port.id!r} has no balance")
        return self.flat.equations[port.entrance.equation]

    def _class_at(self, equation: FlatEquation) -> ClassText | None:
        return None if equation.place is None else self.known.at(equation.place)[1]

    def _entry(self, port: Port, cls: ClassText, prefix: str) -> Entry:
        """Where a term enters, among the equations of a class whose names stand behind ``prefix`` in the flat model."""
        values = {n.removeprefix(prefix): v for n, v in parameter_values(self.flat).items()}
        constants = frozenset(v.name.removeprefix(prefix) for v in self.flat.variables if v.constant)
        drivers = [n.replace(prefix, "", 1) for n in driver_names(self.structure, next(iter(port.signals.values())))]
        wanted = self._words(port)
        found: list[tuple[bool, int, Entry]] = []
        for s in cls.statements:
            sides = self._sides(s, cls)
            if sides is None or s.inside:
                continue
            for name in drivers:
                entry = entry_of(sides, is_driver(name), constants=constants, values=values)
                if entry is not None:
                    found.append(([t.word for t in s.core] != wanted, len(found), entry))
                    break
        if not found:
            raise InputError(f"{self._equation_of(port).place}: no term can be written into the balance of {port.id!r}")
        return min(found, key=lambda f: f[:2])[2]

    def _words(self, port: Port) -> list[str]:
        """The balance as it stands in the user's source."""
        equation = self._equation_of(port)
        if equation.place is None:
            return []
        _, cls, position = self.known.at(equation.place)
        return next(([t.word for t in s.core] for s in cls.statements if s.start <= position < s.end), [])

    def _sides(self, s: Statement, cls: ClassText) -> tuple[Term, Term] | None:
        """Both sides of an equation, or of a declaration with a value."""
        if s.section == "equation":
            return sides_of(s.core)
        c = next((c for c in cls.components() if c.statement is s and c.binding), None)
        if c is None or c.prefixes & {"parameter", "constant"}:
            return None
        return Term("name", c.name_token.start, c.name_token.end, c.name), parse_term(c.binding)

    def _inherits(self) -> bool:
        """Whether something that is to be edited stands in a base class of the user's class."""
        own = {c.name for c in self.user[1].components()}
        for use in self.uses:
            for port in (use.port, *([use.neighbour] if use.neighbour else ())):
                if port.via in ("input", "output") and port.signals["u"] not in own:
                    return True
                if port.via == "equation":
                    equation = self._equation_of(port)
                    stated = self._class_at(equation)
                    inside = equation.component
                    if (inside and inside not in own) or (not inside and stated is not self.user[1]):
                        return True
                if port.via == "series" and self._connection(self.user[1], port) is None:
                    return True
        return False

    # connections

    def _at_node(self, use: Use) -> None:
        port, exchange = use.port, use.law.kind == "exchange"
        ends = {"port": port.connectors[0]}
        flows = [f"port.{port.flow} = {use.law.shape.acts};"]
        inside = self._inside(port)
        if use.neighbour is not None:
            ends["neighbour"] = use.neighbour.connectors[0]
            flows.append(f"neighbour.{use.neighbour.flow} = -{'q' if exchange else 'q_2'};")
        if exchange:
            inside = {"h_1": f"port.{port.potential}", "h_2": f"neighbour.{port.potential}"}
        given = {k: v for k, v in port.signals.items() if k not in inside}
        connector = self._connector_class(port)
        self._component(use, given, inside, [f"{connector} {end};" for end in ends], flows)
        self.equations += [f"connect({use.instance}.{end}, {outer});" for end, outer in ends.items()]

    def _inside(self, port: Port) -> dict[str, str]:
        """What a law's class can take from its own connector: the potential, or its rate."""
        potential = f"port.{port.potential}"
        if port.kind == "storage":
            return {"h": potential}
        if self.structure.of(f"{port.connectors[0]}.{port.potential}") == self.structure.of(port.signals.get("x", "")):
            return {"v": f"der({potential})", "x": potential}
        return {"v": potential}

    def _connector_class(self, port: Port) -> str:
        place = self.structure.variables[f"{port.connectors[0]}.{port.flow}"].place
        if place is None:
            raise InputError(f"{port.id}: the class of its connector is not known")
        return self.known.at(place)[1].full_name

    def _in_series(self, use: Use) -> None:
        port = use.port
        left, right = port.connectors
        connector = self._connector_class(port)
        equations = [f"p.{port.potential} - n.{port.potential} = v;", f"p.{port.flow} + n.{port.flow} = 0;"]
        self._component(use, {}, {"i": f"p.{port.flow}"}, [f"{connector} p;", f"{connector} n;"], equations)
        found = self._connection(self.cls, port)
        if found is None:
            raise InputError(f"{self.cls.full_name}: no connection of {left} and {right} stands in the class")
        near, far = ("p", "n") if found[1][0] == left else ("n", "p")
        self.edits += insert_in_connect(self.file.text, found[0], f"{use.instance}.{near}", f"{use.instance}.{far}")

    @staticmethod
    def _connection(cls: ClassText, port: Port) -> tuple[Statement, list[str]] | None:
        """The statement that joins the two connectors of a port, and these in its order."""
        for s in cls.equations:
            ends = ["".join(t.word for t in e) for e in split_outside(s.core[2:-1])] if s.first == "connect" else []
            if sorted(ends) == sorted(port.connectors) and not s.inside:
                return s, ends
        return None

    # inputs and outputs

    def _at_input(self, use: Use) -> None:
        name = self._declared(use)
        self._component(use, {"u": name}, {})
        if name in self.read:
            # what a law gives that is there already is now given what this one gives
            self.instances[self.read[name].removesuffix(".y")][1]["u"] = f"{use.instance}.y"
        self.read.setdefault(name, f"{use.instance}.y")

    def _declared(self, use: Use) -> str:
        name = use.port.signals["u"]
        if name not in self.components:
            raise InputError(f"{self.cls.full_name}: {name!r} is not declared in the class itself")
        return name

    def _at_output(self, use: Use) -> None:
        name = self._declared(use)
        inner = self.outputs.get(name)
        self.outputs[name] = f"{use.instance}.y"
        if inner is not None:
            self._component(use, {"u": inner}, {})
            return
        c = self.components[name]
        giving = [s for s in self.cls.equations if [t.word for t in s.core[:2]] == [name, "="] and not s.inside]
        if c.binding or (len(giving) == 1 and f"der({name})" not in self._derivatives()):
            self.moved[name] = c.binding or giving[0].core[2:]
            self._component(use, {"u": ""}, {})
            self.read[name] = f"{use.instance}.u"
        else:
            self._true_value(use, c)

    def _derivatives(self) -> set[str]:
        triples = (t for s in self.cls.equations for t in zip(*(s.tokens[k:] for k in range(3)), strict=False))
        return {f"der({c.word})" for a, b, c in triples if a.word == "der" and b.word == "("}

    def _true_value(self, use: Use, c: Component) -> None:
        """An output that other equations solve for: what it was gets a name of its own."""
        true = f"{c.name}_true"
        self._component(use, {"u": true}, {})
        self.variables.append(f'Real {true}{_slice(self.file.text, c.arguments)} "{c.description or c.name}, unread";')
        if c.arguments:
            kept = [f"{k} = {_slice(self.file.text, v)}" for k, v in c.modifiers if k in ("unit", "displayUnit")]
            text = f"({', '.join(kept)})" if kept else ""
            self.edits.append(Edit(c.arguments[0].start, c.arguments[-1].end, text))
        self.read[c.name] = true

    # the two ways to put it together

    def _declarations(self) -> list[str]:
        lines = [*self.parameters, *self.variables]
        for cls, (instance, (name, bound)) in zip(self.classes, self.instances.items(), strict=True):
            lines += [*cls, f"{name} {instance}({', '.join(f'{k} = {v}' for k, v in bound.items())});"]
        return [*lines, *self._copied_classes("")]

    def _copied_classes(self, parent: str) -> list[str]:
        """The lines of the copies of classes of the components that something holds."""
        lines: list[str] = []
        for path, copy in self.copies.items():
            if path.rpartition(".")[0] == parent:
                inner = self._copied_classes(path)
                edits = [*copy.edits, *rename_class(copy.cls, copy.name), *self._retyped_in(path, copy.cls, copy.text)]
                edits += add_declarations(copy.text, copy.cls, [*copy.declarations, *inner])
                lines += apply(copy.text, edits).rstrip("\n").split("\n")
        return lines

    def _retyped_in(self, parent: str, cls: ClassText, text: str) -> list[Edit]:
        """Declare the components of a class by the copies of their classes."""
        held = {path.rpartition(".")[2]: c for path, c in self.copies.items() if path.rpartition(".")[0] == parent}
        return [e for name, copy in held.items() for e in _retyped(cls, name, copy)]

    def _about(self) -> str:
        added = " and ".join(
            f"{u.law.description[:1].lower()}{u.law.description[1:]} at {u.port.id}" for u in self.uses
        )
        return f"{self.user[1].description or self.user[1].name}, with {added}".replace('"', "'")

    def _extension(self) -> str:
        lines = ["within ;", f'model {self.title} "{self._about()}"', f"  extends {self.user[1].full_name};"]
        lines += [f"  {line}" for line in self._declarations()]
        return "\n".join([*lines, "equation", *(f"  {line}" for line in self.equations), f"end {self.title};", ""])

    def _copy(self) -> str:
        text, cls = self.file.text, self.cls
        edits = [*self.edits, *rename_class(cls, self.title), self._description()]
        for name, tokens in self.moved.items():
            instance = self.read[name].removesuffix(".u")
            self.instances[instance][1]["u"] = self._renamed(tokens)
            edits.append(Edit(tokens[0].start, tokens[-1].end, self.outputs[name]))
        self.equations += [f"{name} = {y};" for name, y in self.outputs.items() if name not in self.moved]
        gone = [(tokens[0].start, tokens[-1].end) for tokens in self.moved.values()]
        for s in cls.statements:
            names = {c.name_token.start for c in self.components.values() if c.statement is s}
            if s.section == "equation" and s.core[:1] and s.core[0].word in self.moved:
                names.add(s.core[0].start)
            edits += [
                e
                for e in replace_names(s.tokens, self.read.get)
                if e.start not in names and not any(start <= e.start < end for start, end in gone)
            ]
        edits += self._retyped_in("", cls, text)
        edits += add_declarations(text, cls, self._declarations())
        return apply(text, [*edits, *add_equations(text, cls, self.equations)])

    def _renamed(self, tokens: Sequence[Token]) -> str:
        begin = tokens[0].start
        edits = [e.moved(-begin) for e in replace_names(tokens, self.read.get)]
        return apply(_slice(self.file.text, tokens), edits)

    def _description(self) -> Edit:
        head = self.cls.name_token.end
        return Edit(head, self.cls.body if self.cls.description else head, f' "{self._about()}"')


def _slice(text: str, tokens: Sequence[Token]) -> str:
    return text[tokens[0].start : tokens[-1].end] if tokens else ""


def _retyped(cls: ClassText, name: str, copy: ComponentCopy) -> list[Edit]:
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
