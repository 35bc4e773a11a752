"""The text of a user's class with laws in it."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence

from aero_bayes.errors import InputError
from aero_bayes.export.flat import FlatModel
from aero_bayes.physics.balance import entry_of, sides_of
from aero_bayes.physics.classes import ClassText, Component
from aero_bayes.physics.edit import (
    Edit,
    add_declarations,
    add_equations,
    apply,
    indentation,
    insert_in_connect,
    rename_class,
    replace_names,
)
from aero_bayes.physics.entrance import parameter_values
from aero_bayes.physics.law_class import class_text
from aero_bayes.physics.ports import Port, driver_names, is_driver
from aero_bayes.physics.sources import SourceFile, Sources
from aero_bayes.physics.structure import structure_of
from aero_bayes.physics.terms import Term, parse_term
from aero_bayes.physics.tokens import Token, split_outside
from aero_bayes.physics.use import Use


class Writer:
    """Gathers what each law brings: declarations, equations, edits of what is there."""

    def __init__(
        self, known: Sources, file: SourceFile, cls: ClassText, flat: FlatModel, uses: Sequence[Use], title: str
    ) -> None:
        self.known, self.file, self.cls, self.flat, self.uses, self.title = known, file, cls, flat, uses, title
        self.structure = structure_of(flat)
        self.components: dict[str, Component] = {c.name: c for c in cls.components()}
        self.meanings = {
            k: v for k, v in known.meanings(cls).items() if k not in self.components.keys() | set(cls.short)
        }
        self.whole_file = file.classes == (cls,) and not cls.within
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

    def text(self) -> str:
        """The whole file."""
        ways: Mapping[str, Callable[[Use], None]] = {
            "input": self._at_input, "output": self._at_output, "equation": self._in_equation,
            "node": self._at_node, "series": self._in_series,
        }  # fmt: skip
        for use in self.uses:
            self._parameters(use)
            ways[use.port.via](use)
        return self._extension() if self.extends else self._copy()

    def original(self) -> str:
        """The user's class as a file of its own, to compare with."""
        if self.whole_file:
            return self.file.text
        return self._alone(self.file.text, ())

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
        while name in self.meanings or name in self.cls.short:
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
        given, exchange = use.port.signals, use.law.kind == "exchange"
        if exchange and use.neighbour is not None:
            given = {"h_1": use.port.signals["h"], "h_2": use.neighbour.signals["h"]}
        self._component(use, given, {})
        self._term(use.port, f"{use.instance}.{use.law.shape.acts}", 1)
        if use.neighbour is not None:
            self._term(use.neighbour, f"{use.instance}.{'q' if exchange else 'q_2'}", -1)

    def _term(self, port: Port, text: str, sign: int) -> None:
        equation = self.flat.equations[port.entrance.equation] if port.entrance is not None else None
        if equation is None or equation.place is None:
            raise InputError(f"{port.id}: the place of its balance is not known")
        _, cls, position = self.known.at(equation.place)
        if cls.full_name != self.cls.full_name:
            raise InputError(f"{equation.place}: the balance of {port.id!r} stands in the class {cls.full_name}")
        sides = self._sides(position)
        values = parameter_values(self.flat)
        constants = frozenset(v.name for v in self.flat.variables if v.constant)
        for name in driver_names(self.structure, port.id):
            entry = entry_of(sides, is_driver(name), constants=constants, values=values)
            if entry is not None:
                self.edits += entry.insert(text, sign)
                return
        raise InputError(f"{equation.place}: no term can be written into the balance of {port.id!r}")

    def _sides(self, position: int) -> tuple[Term, Term]:
        """Both sides of the equation, or of the declaration with a value, at a position."""
        s = next((s for s in self.cls.statements if s.start <= position < s.end), None)
        if s is not None and s.section in ("public", "protected"):
            c = next(c for c in self.components.values() if c.statement is s and c.binding)
            return Term("name", c.name_token.start, c.name_token.end, c.name), parse_term(c.binding)
        sides = sides_of(s.core) if s is not None and not s.inside else None
        if sides is None:
            raise InputError(f"{self.file.file}: a branch, a loop or an array, into which no term can be written")
        return sides

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
        for s in self.cls.equations:
            ends = ["".join(t.word for t in e) for e in split_outside(s.core[2:-1])] if s.first == "connect" else []
            if sorted(ends) == sorted((left, right)) and not s.inside:
                near, far = ("p", "n") if ends[0] == left else ("n", "p")
                self.edits += insert_in_connect(self.file.text, s, f"{use.instance}.{near}", f"{use.instance}.{far}")
                return
        raise InputError(f"{self.cls.full_name}: no connection of {left} and {right} stands in the class itself")

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
        return lines

    def _about(self) -> str:
        added = " and ".join(
            f"{u.law.description[:1].lower()}{u.law.description[1:]} at {u.port.id}" for u in self.uses
        )
        return f"{self.cls.description or self.cls.name}, with {added}".replace('"', "'")

    def _extension(self) -> str:
        lines = ["within ;", f'model {self.title} "{self._about()}"', f"  extends {self.cls.full_name};"]
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
                for e in replace_names(s.tokens, self._new_name)
                if e.start not in names and not any(start <= e.start < end for start, end in gone)
            ]
        edits += add_declarations(text, cls, self._declarations())
        edits += add_equations(text, cls, self.equations)
        return apply(text, edits) if self.whole_file else self._alone(text, edits)

    def _alone(self, text: str, edits: Sequence[Edit]) -> str:
        """The class out of its package, moved to the margin."""
        begin = text.rfind("\n", 0, self.cls.start) + 1
        margin = indentation(text, self.cls.start)
        body = apply(text[begin : self.cls.end], [e.moved(-begin) for e in edits])
        return "within ;\n" + re.sub(rf"^{margin}", "", body, flags=re.MULTILINE) + "\n"

    def _new_name(self, name: str) -> str | None:
        return self.read.get(name) or self.meanings.get(name)

    def _renamed(self, tokens: Sequence[Token]) -> str:
        begin = tokens[0].start
        edits = [e.moved(-begin) for e in replace_names(tokens, self._new_name)]
        return apply(_slice(self.file.text, tokens), edits)

    def _description(self) -> Edit:
        head = self.cls.name_token.end
        return Edit(head, self.cls.body if self.cls.description else head, f' "{self._about()}"')


def _slice(text: str, tokens: Sequence[Token]) -> str:
    return text[tokens[0].start : tokens[-1].end] if tokens else ""
