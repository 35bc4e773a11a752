"""The published systems as sums of terms, and the Modelica models that lack one of them."""

from __future__ import annotations

import ast
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import sympy
from sympy.printing.str import StrPrinter

#: What a first model's constants are off by, in turn.
OFF = (1.3, 0.7)


@dataclass(frozen=True)
class Term:
    """An additive term in the rate of a state, by the index of the state."""

    state: int
    value: sympy.Expr


@dataclass(frozen=True)
class System:
    """A published system: terms of each rate, values of constants, and two starts.

    Parameters
    ----------
    number : int
    rates : tuple of tuple of sympy.Expr
        The additive terms of each rate.
    constants : dict of str to float
    starts : tuple of tuple of float
    """

    number: int
    rates: tuple[tuple[sympy.Expr, ...], ...]
    constants: dict[str, float]
    starts: tuple[tuple[float, ...], ...]

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states."""
        return tuple(f"x_{k}" for k in range(len(self.rates)))

    def terms(self) -> list[Term]:
        """Return the terms of rates that have more than one."""
        return [Term(k, term) for k, rate in enumerate(self.rates) if len(rate) > 1 for term in rate]

    def without(self, term: Term) -> System:
        """Return the system that lacks a term, and the constants that no other term has."""
        rates = tuple(tuple(t for t in rate if k != term.state or t != term.value) for k, rate in enumerate(self.rates))
        used = {str(s) for rate in rates for t in rate for s in t.free_symbols}
        return replace(self, rates=rates, constants={n: v for n, v in self.constants.items() if n in used})

    def modelica(self, start: Sequence[float], hidden: int | None) -> str:
        """Write it as a first model: its constants are off, and a hidden state is no output."""
        lines = ['model Rig "A published system, perhaps without one of its terms"']
        for k, (name, value) in enumerate(self.constants.items()):
            lines.append(f'  parameter Real {name} = {value * OFF[k % 2]:.6g} "Constant";')
        for k, name in enumerate(self.states):
            given = "" if k == hidden else "output "
            lines.append(f'  {given}Real {name}(start = {start[k]!r}, fixed = true) "State";')
        lines.append("equation")
        lines += [f"  der({name}) = {_modelica(rate)};" for name, rate in zip(self.states, self.rates, strict=True)]
        return "\n".join([*lines, "end Rig;", ""])


@dataclass(frozen=True)
class Task:
    """One loop: a system, the term that is deleted, the state that is not recorded, and the noise of the readings.

    Noise is a share of the standard deviation of each state. ``term`` is None where nothing is deleted.
    """

    system: System
    term: Term | None
    hidden: int | None
    noise: float

    @property
    def key(self) -> str:
        """Name of the task."""
        where = "nothing" if self.term is None else f"{self.term.state}-{self._index}"
        seen = "all" if self.hidden is None else f"without-x_{self.hidden}"
        return f"{self.system.number:02d}-{where}-{seen}-{self.noise:g}"

    @property
    def first_model(self) -> System:
        """The system that is fitted."""
        return self.system if self.term is None else self.system.without(self.term)

    @property
    def _index(self) -> int:
        assert self.term is not None
        return self.system.rates[self.term.state].index(self.term.value)


def read_systems(path: Path) -> list[System]:
    """Read the file of the benchmark; nothing in it is run."""
    tree = _WithNumbers().visit(ast.parse(path.read_text(encoding="utf-8")))
    (entries,) = (
        ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "equations"
    )
    return [_system(entry) for entry in entries]


class _WithNumbers(ast.NodeTransformer):
    """Replaces quotients of numbers, such as 8/3, by their values."""

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        if isinstance(node.left, ast.Constant) and isinstance(node.right, ast.Constant):
            return ast.Constant(float(sympy.sympify(ast.unparse(node))))
        return node


def tasks_of(system: System, noise: float) -> dict[str, list[Task]]:
    """Return the tasks of a system by kind: with all states recorded, with one hidden, and with nothing deleted."""
    deleted = system.terms()
    states = range(len(system.rates))
    return {
        "all_states": [Task(system, term, None, noise) for term in deleted],
        "one_hidden": [Task(system, term, k, noise) for term in deleted for k in states if len(states) > 1],
        "nothing_deleted": [Task(system, None, None, noise)],
    }


def _system(entry: dict[str, object]) -> System:
    values = entry["consts"][0]  # type: ignore[index]
    constants = {f"c_{k}": float(v) for k, v in enumerate(values)}
    rates = []
    for text in str(entry["eq"]).split("|"):
        rate = sympy.expand(sympy.sympify(text.replace("^", "**")))
        rates.append(tuple(sympy.Add.make_args(rate)))
    starts = tuple(tuple(map(float, start)) for start in entry["init"])  # type: ignore[attr-defined]
    used = {str(s) for rate in rates for t in rate for s in t.free_symbols}
    return System(int(entry["id"]), tuple(rates), {n: v for n, v in constants.items() if n in used}, starts)  # type: ignore[call-overload]


class _ModelicaPrinter(StrPrinter):
    """Writes expressions as Modelica does."""

    def _print_Pow(self, expr: sympy.Pow, rational: bool = False) -> str:
        return super()._print_Pow(expr, rational).replace("**", "^")

    def _print_cot(self, expr: sympy.cot) -> str:
        return f"(1/tan({self._print(expr.args[0])}))"

    def _print_Abs(self, expr: sympy.Abs) -> str:
        return f"abs({self._print(expr.args[0])})"

    def _print_Rational(self, expr: sympy.Rational) -> str:
        return f"({float(expr)!r})"


def _modelica(terms: Sequence[sympy.Expr]) -> str:
    return " + ".join(f"({_ModelicaPrinter().doprint(t)})" for t in terms).replace("+ (-", "- (") or "0"
