"""Laws written as terms of balance equations, in the class itself or in a copy of a component's class."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from aero_bayes.errors import InputError
from aero_bayes.laws.aliases import AliasStructure
from aero_bayes.laws.balance import Port, parameter_values
from aero_bayes.laws.candidates import PlacedLaw, identifier
from aero_bayes.laws.class_with_laws import ClassWithLaws, formula, without_indices
from aero_bayes.laws.find import driver_names, is_driver
from aero_bayes.laws.insertion_point import InsertionPoint, find_insertion_point, in_vector
from aero_bayes.modelica.classes import ClassText, SourceStatement
from aero_bayes.modelica.compose import attribute_value
from aero_bayes.modelica.flat import FlatEquation, FlatModel
from aero_bayes.modelica.parse import find_outside, parse_expression, sides_of
from aero_bayes.modelica.sources import Sources
from aero_bayes.modelica.syntax import Expression, Name

#: Longest formula that is written as a term. A law with a longer one is written as a component.
MAX_FORMULA_LENGTH = 70


class BalanceWriter:
    """Writes laws into balance equations."""

    def __init__(
        self,
        target: ClassWithLaws,
        known: Sources,
        flat: FlatModel,
        structure: AliasStructure,
        max_formula_length: int,
    ) -> None:
        self.target, self.known, self.flat, self.structure = target, known, flat, structure
        self.max_formula_length = max_formula_length
        self.whole_numbers = {
            v.name: round(attribute_value(flat, v.name, "value"))
            for v in flat.variables
            if v.constant and v.type == "Integer" and not v.sizes
        }

    def write(self, placed: PlacedLaw) -> None:
        wired = self.target.wires[placed.instance]
        given = {read.input: self.target.called(read) for read in wired.reads}
        near = all(not equation_of(self.flat, port).component for port in wired.ports)
        text = formula(placed.law, nominals=placed.all_nominals, names={**given, **placed.names}) if near else None
        if text is None or len(text) > self.max_formula_length:
            self.target.declare(placed, given, {})
            text = None
        for added in wired.added:
            self._term(added.port, text or f"{placed.instance}.{added.output}", added.sign)

    def _term(self, port: Port, text: str, sign: int) -> None:
        """Append a term to the balance of a port, in the class itself or in a copy of its component's class."""
        equation = equation_of(self.flat, port)
        sign *= port.balance.sign if port.balance is not None else 1
        if not equation.component:
            if not self.target.inherits and class_of(self.known, equation) is not self.target.user[1]:
                raise InputError(f"{equation.place}: the balance of {port.id!r} stands in a base class")
            self.target.edits += self._entry(port, self.target.cls, "").insert(text, sign)
            return
        path, numbers = without_indices(equation.component)
        copy = self.target.copy_of(path)
        stated = class_of(self.known, equation)
        if stated is None or stated.name != copy.origin.name:
            copy.write_out_bases(self.known)
        # two elements of an array of components share the copy of their class
        given = identifier(text) if identifier(text) not in copy.inputs else f"{identifier(text)}_in"
        copy.edits += self._entry(port, copy.cls, equation.component + ".").insert(given, sign)
        about = f'"{"Taken from" if sign > 0 else "Added to"} the balance"'
        while path:
            parent = path.rpartition(".")[0]
            value = given if parent else text
            if path in numbers:
                value = in_vector(value, (numbers[path], self._count(path)))
            self.target.copies[path].add_input(given, value, about)
            path = parent

    def _count(self, path: str) -> int:
        """Return how many components an array of them has."""
        known = (without_indices(v.name.rpartition(".")[0])[1].get(path, 0) for v in self.flat.variables)
        return max(known, default=0)

    def _entry(self, port: Port, cls: ClassText, prefix: str) -> InsertionPoint:
        """Find where a term enters in the equations of a class, whose names have a ``prefix`` in the flat model."""
        flat = self.structure.flat
        values = {n.removeprefix(prefix): v for n, v in parameter_values(flat).items()}
        constants = frozenset(v.name.removeprefix(prefix) for v in flat.variables if v.constant)
        whole = {n.removeprefix(prefix): k for n, k in self.whole_numbers.items()}
        state, force = (port.balance.state, port.balance.force) if port.balance is not None else ("", "")
        drivers = [force] if force else [n.replace(prefix, "", 1) for n in driver_names(self.structure, state)]
        wanted = self._words(port)
        row = port.balance.row if port.balance is not None else None
        found: list[tuple[bool, int, InsertionPoint]] = []
        for s in cls.statements:
            for loop in self._turns(s):
                sides = self._sides(s, cls, whole | dict([loop] if loop else []))
                if sides is None:
                    continue
                for name in drivers:
                    driver = is_driver(name, whole=row is not None)
                    entry = find_insertion_point(sides, driver, constants=constants, values=values, row=row)
                    if entry is not None:
                        entry = replace(entry, loop=loop)
                        found.append(([t.word for t in s.core] != wanted, len(found), entry))
                        break
        if not found:
            raise InputError(
                f"{equation_of(self.flat, port).place}: no term can be written into the balance of {port.id!r}"
            )
        return min(found, key=lambda f: f[:2])[2]

    def _turns(self, s: SourceStatement) -> list[tuple[str, int] | None]:
        """Return nothing for a statement by itself; the variable of a loop around it with each value it may have."""
        if not s.inside:
            return [None]
        words = [t.word for t in s.head]
        if s.inside != ("for",) or words[2:3] != ["in"] or find_outside(s.head, frozenset({","})) < len(s.head):
            return []
        most = max((max(v.sizes) for v in self.flat.variables if v.sizes), default=0)
        return [(s.head[1].word, k) for k in range(most + 2)]

    def _words(self, port: Port) -> list[str]:
        """Return the balance as it stands in the user's source."""
        equation = equation_of(self.flat, port)
        if equation.place is None:
            return []
        _, cls, position = self.known.at(equation.place)
        return next(([t.word for t in s.core] for s in cls.statements if s.start <= position < s.end), [])

    def _sides(
        self, s: SourceStatement, cls: ClassText, whole: Mapping[str, int]
    ) -> tuple[Expression, Expression] | None:
        """Return both sides of an equation, or of a declaration with a value.

        ``whole`` are the names of whole numbers."""
        if s.section == "equation":
            return sides_of(s.core, whole)
        c = next((c for c in cls.components() if c.statement is s and c.binding), None)
        if c is None or c.prefixes & {"parameter", "constant"}:
            return None
        return Name(c.name, span=(c.name_token.start, c.name_token.end)), parse_expression(c.binding)


def equation_of(flat: FlatModel, port: Port) -> FlatEquation:
    """Return the balance equation of a port. Raises InputError if it has none."""
    if port.balance is None:
        raise InputError(f"the port {port.id!r} has no balance")
    return flat.equations[port.balance.equation]


def class_of(known: Sources, equation: FlatEquation) -> ClassText | None:
    """Return the class in which an equation is written; None if its place is unknown."""
    return None if equation.place is None else known.at(equation.place)[1]
