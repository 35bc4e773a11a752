"""What a law brings to a user's class at each kind of port: a term, a component at a connection, a signal passed on."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from aero_bayes.errors import InputError
from aero_bayes.export.compose import ACTING, TRUE, attribute_value, element_names
from aero_bayes.export.flat import FlatEquation, FlatModel
from aero_bayes.language.classes import ClassText, ComponentDeclaration, SourceStatement
from aero_bayes.language.edits import TextEdit, insert_before_connector, text_of
from aero_bayes.language.parse import parse_expression, sides_of
from aero_bayes.language.sources import SourceFile, Sources
from aero_bayes.language.syntax import Expression, Name, parse_reference
from aero_bayes.language.tokens import find_outside, split_outside, words_of
from aero_bayes.laws.class_with_laws import ClassWithLaws
from aero_bayes.laws.component_copies import without_numbers
from aero_bayes.laws.law_text import formula
from aero_bayes.laws.use import Use, plain_name
from aero_bayes.ports.balance import Entry, entry_of, in_vector
from aero_bayes.ports.equal_variables import structure_of
from aero_bayes.ports.find import driver_names, is_driver
from aero_bayes.ports.port import DIFFERENCE_SIGN, Port, Via
from aero_bayes.ports.residual import parameter_values

#: A law whose formula is longer than this is written as a component.
MAX_FORMULA_LENGTH = 70
#: Which laws are written before others.
_WRITING_ORDER: Mapping[Via, int] = {"output": 0, "input": 1}
_COMMA, _EQUALS = frozenset({","}), frozenset({"="})


class LawWriter:
    """Adds laws to the text of a class."""

    def __init__(
        self, known: Sources, user: tuple[SourceFile, ClassText], flat: FlatModel, uses: Sequence[Use], title: str
    ) -> None:
        self.known, self.uses = known, uses
        self.structure = structure_of(flat)
        self.flat = flat
        self.whole_numbers = {
            v.name: round(attribute_value(flat, v.name, "value"))
            for v in flat.variables
            if v.constant and v.type == "Integer" and not v.sizes
        }
        self.target = ClassWithLaws(known, user, uses, title, inherits=self._inherits(user[1]))

    def text(self) -> str:
        """The whole file."""
        ways: Mapping[str, Callable[[Use], None]] = {
            "input": self._at_input, "output": self._at_output, "signal": self._at_signal,
            "equation": self._in_equation, "node": self._at_node, "series": self._in_series,
        }  # fmt: skip
        # what a law in a balance reads is called by then as laws at outputs and inputs have it
        for use in sorted(self.uses, key=lambda u: _WRITING_ORDER.get(u.port.via, 2)):
            ways[use.port.via](use)
        return self.target.written()

    def _in_equation(self, use: Use) -> None:
        given, exchange = dict(use.port.signals), use.law.kind == "exchange"
        if exchange and use.neighbour is not None:
            given = {"h_1": use.port.signals["h"], "h_2": use.neighbour.signals["h"]}
        # a reading that is a state has a name of its own for what it was
        given = {signal: self._read(name) for signal, name in given.items()}
        near = all(not self._equation_of(p).component for p in (use.port, use.neighbour) if p is not None)
        text = formula(use.law, sizes=use.all_sizes, names={**given, **use.names}) if near else None
        if text is None or len(text) > MAX_FORMULA_LENGTH:
            self.target.declare(use, given, {})
            text = f"{use.instance}.{use.law.shape.acts}"
        self._term(use.port, text, 1)
        if use.neighbour is not None:
            self._term(use.neighbour, f"{use.instance}.q_2" if use.law.kind == "overflow" else text, -1)

    def _read(self, given: str) -> str:
        """A variable, or a difference of two, as it is called beside laws at outputs."""
        parts = [self.target.read.get(name, name) for name in given.split(DIFFERENCE_SIGN)]
        return f"({DIFFERENCE_SIGN.join(parts)})" if len(parts) > 1 else parts[0]

    def _term(self, port: Port, text: str, sign: int) -> None:
        """Append a term to the balance of a port, in the class itself or in a copy of its component's class."""
        equation = self._equation_of(port)
        if not equation.component:
            self.target.edits += self._entry(port, self.target.cls, "").insert(text, sign)
            return
        path, numbers = without_numbers(equation.component)
        copy = self.target.copy_of(path)
        stated = self._class_at(equation)
        if stated is None or stated.name != copy.origin.name:
            copy.write_out_bases(self.known)
        # two elements of an array of components share the copy of their class
        given = plain_name(text) if plain_name(text) not in copy.inputs else f"{plain_name(text)}_in"
        copy.edits += self._entry(port, copy.cls, equation.component + ".").insert(given, sign)
        about = f'"{"Taken from" if sign > 0 else "Added to"} the balance"'
        while path:
            parent = path.rpartition(".")[0]
            value = given if parent else text
            if path in numbers:
                value = in_vector(value, (numbers[path], self._count(path)))
            self.target.copies[path].take(given, value, about)
            path = parent

    def _count(self, path: str) -> int:
        """How many components an array of them has."""
        known = (without_numbers(v.name.rpartition(".")[0])[1].get(path, 0) for v in self.flat.variables)
        return max(known, default=0)

    def _equation_of(self, port: Port) -> FlatEquation:
        if port.entrance is None:
            raise InputError(f"the port {port.id!r} has no balance")
        return self.flat.equations[port.entrance.equation]

    def _class_at(self, equation: FlatEquation) -> ClassText | None:
        return None if equation.place is None else self.known.at(equation.place)[1]

    def _entry(self, port: Port, cls: ClassText, prefix: str) -> Entry:
        """Where a term enters, among the equations of a class whose names stand behind ``prefix`` in the flat model."""
        flat = self.structure.flat
        values = {n.removeprefix(prefix): v for n, v in parameter_values(flat).items()}
        constants = frozenset(v.name.removeprefix(prefix) for v in flat.variables if v.constant)
        whole = {n.removeprefix(prefix): k for n, k in self.whole_numbers.items()}
        state = port.entrance.state if port.entrance is not None else ""
        drivers = [n.replace(prefix, "", 1) for n in driver_names(self.structure, state)]
        wanted = self._words(port)
        row = port.entrance.row if port.entrance is not None else None
        found: list[tuple[bool, int, Entry]] = []
        for s in cls.statements:
            for loop in self._turns(s):
                sides = self._sides(s, cls, whole | dict([loop] if loop else []))
                if sides is None:
                    continue
                for name in drivers:
                    driver = is_driver(name, whole=row is not None)
                    entry = entry_of(sides, driver, constants=constants, values=values, row=row)
                    if entry is not None:
                        entry = replace(entry, loop=loop)
                        found.append(([t.word for t in s.core] != wanted, len(found), entry))
                        break
        if not found:
            raise InputError(f"{self._equation_of(port).place}: no term can be written into the balance of {port.id!r}")
        return min(found, key=lambda f: f[:2])[2]

    def _turns(self, s: SourceStatement) -> list[tuple[str, int] | None]:
        """Nothing for a statement by itself; the variable of a loop around it with each value it may have."""
        if not s.inside:
            return [None]
        words = [t.word for t in s.head]
        if s.inside != ("for",) or words[2:3] != ["in"] or find_outside(s.head, _COMMA) < len(s.head):
            return []
        most = max((max(v.sizes) for v in self.flat.variables if v.sizes), default=0)
        return [(s.head[1].word, k) for k in range(most + 2)]

    def _words(self, port: Port) -> list[str]:
        """The balance as it stands in the user's source."""
        equation = self._equation_of(port)
        if equation.place is None:
            return []
        _, cls, position = self.known.at(equation.place)
        return next(([t.word for t in s.core] for s in cls.statements if s.start <= position < s.end), [])

    def _sides(
        self, s: SourceStatement, cls: ClassText, whole: Mapping[str, int]
    ) -> tuple[Expression, Expression] | None:
        """Both sides of an equation, or of a declaration with a value; ``whole`` are the names of whole numbers."""
        if s.section == "equation":
            return sides_of(s.core, whole)
        c = next((c for c in cls.components() if c.statement is s and c.binding), None)
        if c is None or c.prefixes & {"parameter", "constant"}:
            return None
        return Name(c.name, span=(c.name_token.start, c.name_token.end)), parse_expression(c.binding)

    # connections

    def _at_node(self, use: Use) -> None:
        port, exchange = use.port, use.law.kind == "exchange"
        ends = {"port": port.connectors[0]}
        flows = [f"port.{port.flow} = {use.law.shape.acts};"]
        inside = self._inside(port)
        if use.neighbour is not None:
            ends["neighbour"] = use.neighbour.connectors[0]
            taken = "q_2" if use.law.kind == "overflow" else use.law.shape.acts
            flows.append(f"neighbour.{use.neighbour.flow} = -{taken};")
        if exchange:
            inside = {"h_1": f"port.{port.potential}", "h_2": f"neighbour.{port.potential}"}
        elif use.neighbour is not None and port.kind == "motion":
            other = {k: v.replace("port.", "neighbour.") for k, v in self._inside(use.neighbour).items()}
            inside = {k: f"{v}{DIFFERENCE_SIGN}{other[k]}" for k, v in inside.items() if k in other}
        given = {k: v for k, v in port.signals.items() if k not in inside}
        self.target.declare(use, given, inside, self._connectors(port, *ends), flows)
        self.target.equations += [f"connect({use.instance}.{end}, {outer});" for end, outer in ends.items()]

    def _inside(self, port: Port) -> dict[str, str]:
        """What a law's class can take from its own connector: the potential, or its rate."""
        potential = f"port.{port.potential}"
        if port.kind == "storage":
            return {"h": potential}
        position = port.signals.get("x", "").partition(DIFFERENCE_SIGN)[0]
        if self.structure.of(f"{port.connectors[0]}.{port.potential}") == self.structure.of(position):
            return {"v": f"der({potential})", "x": potential}
        return {"v": potential}

    def _connectors(self, port: Port, *names: str) -> list[str]:
        """Declarations of connectors of the port's kind in a law's class."""
        place = self.structure.variables[f"{port.connectors[0]}.{port.flow}"].place
        if place is None:
            raise InputError(f"{port.id}: the class of its connector is not known")
        file, cls, _ = self.known.at(place)
        if not file.text[cls.start :].startswith("partial"):
            return [f"{cls.full_name} {name};" for name in names]
        whole = ["connector End", f"  extends {cls.full_name};", "end End;"]
        return [*whole, *(f"End {name};" for name in names)]

    def _in_series(self, use: Use) -> None:
        port = use.port
        left, right = port.connectors
        equations = [f"p.{port.potential} - n.{port.potential} = v;", f"p.{port.flow} + n.{port.flow} = 0;"]
        self.target.declare(use, {}, {"i": f"p.{port.flow}"}, self._connectors(port, "p", "n"), equations)
        mine = [u.instance for u in self.uses if u.port.via == "series" and u.port.connectors[1] == right]
        if use.instance != mine[0]:
            return
        edits = self._before(self.target.file.text, self.target.cls, port, mine)
        if not edits:
            raise InputError(f"{self.target.cls.full_name}: no connection of {left} and {right} stands in the class")
        self.target.edits += edits

    @staticmethod
    def _before(text: str, cls: ClassText, port: Port, chain: Sequence[str]) -> list[TextEdit]:
        return insert_before_connector(text, cls.equations, port.connectors[1], [(f"{c}.p", f"{c}.n") for c in chain])

    # inputs and outputs

    def _at_input(self, use: Use) -> None:
        name = use.port.signals["u"]
        c = self._declared(name)
        self.target.declare(use, {"u": name}, {})
        given, inner = self.target.read, name
        if c.name != name:
            if c.name not in self.target.read:
                self.target.read[c.name] = self._apart(c, ACTING)
            given, inner = self.target.given, name.replace(c.name, self.target.read[c.name], 1)
        if given.get(inner, name) != name:
            # what a law gives that is there already is now given what this one gives
            self.target.instances[given[inner].removesuffix(".y")][1]["u"] = f"{use.instance}.y"
        else:
            given[inner] = f"{use.instance}.y"

    def _at_signal(self, use: Use) -> None:
        name = use.port.signals["u"]
        if "." not in name:
            self.target.computed.add(name)
            self._at_input(use)
            return
        connects = self._connects(self.target.cls, name)
        if len(connects) != 1:
            raise InputError(f"{self.target.cls.full_name}: no one connection to {name!r} stands in the class")
        ((statement, source),) = connects
        mine = [u.instance for u in self.uses if u.port.via == "signal" and u.port.signals["u"] == name]
        # each is given what the next one gives, the last one what was connected
        given = dict(zip(mine, [*(f"{next_}.y" for next_ in mine[1:]), source], strict=True))
        self.target.declare(use, {"u": given[use.instance]}, {})
        if use.instance == mine[0]:
            self.target.edits.append(TextEdit(statement.start, statement.end, f"{name} = {use.instance}.y;"))

    @staticmethod
    def _connects(cls: ClassText, name: str) -> list[tuple[SourceStatement, str]]:
        """Connections of a component's input, with what stands at the other end; none in a loop or under a condition.

        What is connected otherwise too has no other end.
        """
        found = []
        for s in cls.equations:
            ends = ["".join(words_of(end)) for end in s.ends]
            if name in ends and not s.inside:
                found.append((s, next((end for end in ends if end != name), "")))
        return found

    def _apart(self, c: ComponentDeclaration, suffix: str) -> str:
        """An array that stands, element by element, for an array of inputs or outputs in the class."""
        sizes = self.structure.variables[c.name].sizes
        inner = f"{c.name}{suffix}"
        if c.binding:
            self.target.freed[inner] = c.binding
        if suffix == ACTING and "input" not in c.prefixes:
            # a connector that takes its causality from its class
            c = replace(c, type="Acting")
            self.target.connectors["Acting"] = "output Real"
        self._declare_like(c, f"{inner}[{', '.join(map(str, sizes))}]", "unread" if suffix == TRUE else "as it acts")
        for outer, own in zip(element_names(c.name, sizes), element_names(inner, sizes), strict=True):
            self.target.given |= {own: outer} if suffix == ACTING else {outer: own}
        return inner

    def _declared(self, name: str) -> ComponentDeclaration:
        base = parse_reference(name).name
        if base not in self.target.components:
            raise InputError(f"{self.target.cls.full_name}: {base!r} is not declared in the class itself")
        return self.target.components[base]

    def _at_output(self, use: Use) -> None:
        name = use.port.signals["u"]
        c = self._declared(name)
        if c.name != name and c.name not in self.target.read:
            self.target.read[c.name] = self._apart(c, TRUE)
            self._without_start(c)
        inner = self.target.given.get(name)
        self.target.given[name] = f"{use.instance}.y"
        if inner is not None:
            self.target.declare(use, {"u": inner}, {})
            return
        giving = [s for s in self.target.cls.equations if [t.word for t in s.core[:2]] == [name, "="] and not s.inside]
        if c.binding or (len(giving) == 1 and name not in self.target.cls.derived()):
            self.target.moved[name] = c.binding or giving[0].core[2:]
            self.target.declare(use, {"u": ""}, {})
            self.target.read[name] = f"{use.instance}.u"
        else:
            # Other equations solve for it: what it was gets a name of its own.
            true = f"{name}{TRUE}"
            self.target.declare(use, {"u": true}, {})
            self._declare_like(c, true, "unread")
            self._without_start(c)
            self.target.read[name] = true

    def _declare_like(self, c: ComponentDeclaration, name: str, about: str) -> None:
        # a connector stays one, since it may be connected
        modified = text_of(self.target.file.text, c.arguments)
        self.target.variables.append(f'{c.type} {name}{modified} "{c.description or c.name}, {about}";')

    def _without_start(self, c: ComponentDeclaration) -> None:
        """What is no state any more keeps its units only."""
        if c.arguments:
            parts = split_outside(c.arguments[1:-1])
            kept = [p for p in parts if {"unit", "displayUnit"} & {t.word for t in p[: find_outside(p, _EQUALS)]}]
            text = f"({', '.join(text_of(self.target.file.text, p) for p in kept)})" if kept else ""
            self.target.edits.append(TextEdit(c.arguments[0].start, c.arguments[-1].end, text))

    # what has to be written out first

    def _inherits(self, cls: ClassText) -> bool:
        """Whether something that is to be edited stands in a base class of the user's class."""
        own = {c.name for c in cls.components()}
        for use in self.uses:
            for port in (use.port, *([use.neighbour] if use.neighbour else ())):
                if port.via == "signal" and "." in port.signals["u"]:
                    if not self._connects(cls, port.signals["u"]):
                        return True
                elif port.via in ("input", "output", "signal") and parse_reference(port.signals["u"]).name not in own:
                    return True
                if port.via == "equation":
                    equation = self._equation_of(port)
                    stated = self._class_at(equation)
                    inside = without_numbers(equation.component)[0]
                    if (inside and inside not in own) or (not inside and stated is not cls):
                        return True
                if port.via == "series" and not self._before("", cls, port, ["law"]):
                    return True
        return False
