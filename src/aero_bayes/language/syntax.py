"""The trees of flat Modelica: expressions and the statements of algorithms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Number:
    """A literal; Booleans are 0 and 1, enumeration literals their ordinals."""

    value: float


@dataclass(frozen=True)
class Name:
    """A component reference; ``subscripts`` of its last part, if any."""

    name: str
    subscripts: tuple[Expression, ...] = ()


@dataclass(frozen=True)
class Text:
    value: str


@dataclass(frozen=True)
class Call:
    """A function call, or an operator by its symbol."""

    function: str
    args: tuple[Expression, ...]


@dataclass(frozen=True)
class If:
    condition: Expression
    then: Expression
    otherwise: Expression


@dataclass(frozen=True)
class Array:
    """Elements of an array, fields of a record, or results of a function with several."""

    items: tuple[Expression, ...]


@dataclass(frozen=True)
class Comprehension:
    item: Expression
    variable: str
    values: Expression


@dataclass(frozen=True)
class Range:
    first: Expression
    step: Expression | None
    last: Expression


@dataclass(frozen=True)
class Index:
    """An element of something that is not a plain name, such as ``der(x)[2]``."""

    of: Expression
    subscripts: tuple[Expression, ...]


@dataclass(frozen=True)
class Field:
    """A field of a record that is not a plain name, such as ``f(x).re``."""

    of: Expression
    name: str


@dataclass(frozen=True)
class All:
    """The subscript ``:``."""


Expression = Number | Name | Text | Call | If | Array | Comprehension | Range | Index | Field | All


@dataclass(frozen=True)
class Assign:
    """``targets := value``; several targets for a function with several results, None where one is left out."""

    targets: tuple[Name | None, ...]
    value: Expression


@dataclass(frozen=True)
class IfStatement:
    branches: tuple[tuple[Expression, tuple[Statement, ...]], ...]
    otherwise: tuple[Statement, ...]


@dataclass(frozen=True)
class ForStatement:
    variable: str
    values: Expression
    body: tuple[Statement, ...]


@dataclass(frozen=True)
class WhileStatement:
    condition: Expression
    body: tuple[Statement, ...]


@dataclass(frozen=True)
class WhenStatement:
    branches: tuple[tuple[Expression, tuple[Statement, ...]], ...]


@dataclass(frozen=True)
class ReinitStatement:
    state: Name
    value: Expression


@dataclass(frozen=True)
class AssertStatement:
    condition: Expression
    message: str


@dataclass(frozen=True)
class Refused:
    """A statement that cannot be translated: an error once it is needed, not where a function merely has it."""

    what: str


Statement = (
    Assign | IfStatement | ForStatement | WhileStatement | WhenStatement | ReinitStatement | AssertStatement | Refused
)


def show(tree: Expression) -> str:
    """A short text for messages."""
    match tree:
        case Name(name, subscripts):
            return name + (f"[{','.join(map(show, subscripts))}]" if subscripts else "")
        case Number(value):
            return f"{value:g}"
        case Call(function, args):
            return f"{function}({', '.join(map(show, args))})"
        case All():
            return ":"
    return type(tree).__name__.lower()


def children(tree: Expression) -> tuple[Expression, ...]:
    """The expressions directly below one."""
    match tree:
        case Name(_, inner) | Call(_, inner) | Array(inner):
            return inner
        case If(condition, then, otherwise):
            return (condition, then, otherwise)
        case Comprehension(item, _, values):
            return (item, values)
        case Range(first, step, last):
            return (first, last) if step is None else (first, step, last)
        case Index(of, subscripts):
            return (of, *subscripts)
        case Field(of, _):
            return (of,)
    return ()


def reference(name: str) -> Name:
    """A variable by its name; ``x[1]`` is an element of ``x``."""
    base, bracket, inside = name.partition("[")
    if not bracket or not name.endswith("]") or "." in inside:
        return Name(name)
    return Name(base, tuple(Number(float(k)) for k in inside[:-1].split(",")))


def names_in(tree: Expression) -> set[str]:
    """The names that an expression refers to."""
    found: set[str] = set()
    stack = [tree]
    while stack:
        item = stack.pop()
        if isinstance(item, Name):
            found.add(item.name)
        stack.extend(children(item))
    return found


def rebuilt(tree: Expression, change: Callable[[Name], Expression]) -> Expression:
    """A copy in which each name (its subscripts already rebuilt) is what ``change`` makes of it."""
    match tree:
        case Name(name, subscripts):
            return change(Name(name, tuple(rebuilt(s, change) for s in subscripts)))
        case Call(function, args):
            return Call(function, tuple(rebuilt(a, change) for a in args))
        case Array(items):
            return Array(tuple(rebuilt(i, change) for i in items))
        case If(condition, then, otherwise):
            return If(rebuilt(condition, change), rebuilt(then, change), rebuilt(otherwise, change))
        case Comprehension(item, variable, values):
            # the loop variable hides a variable of that name
            inner = rebuilt(item, lambda n: n if n.name == variable else change(n))
            return Comprehension(inner, variable, rebuilt(values, change))
        case Range(first, step, last):
            middle = None if step is None else rebuilt(step, change)
            return Range(rebuilt(first, change), middle, rebuilt(last, change))
        case Index(of, subscripts):
            return Index(rebuilt(of, change), tuple(rebuilt(s, change) for s in subscripts))
        case Field(of, name):
            return Field(rebuilt(of, change), name)
    return tree


def rebuilt_statement(s: Statement, change: Callable[[Name], Expression], target: Callable[[Name], Name]) -> Statement:
    """A copy of a statement: expressions by ``change``, what is assigned by ``target``."""

    def body(inner: tuple[Statement, ...]) -> tuple[Statement, ...]:
        return tuple(rebuilt_statement(i, change, target) for i in inner)

    match s:
        case Assign(targets, value):
            return Assign(tuple(None if t is None else target(t) for t in targets), rebuilt(value, change))
        case IfStatement(branches, otherwise):
            return IfStatement(tuple((rebuilt(c, change), body(b)) for c, b in branches), body(otherwise))
        case ForStatement(variable, values, inner):
            return ForStatement(variable, rebuilt(values, change), body(inner))
        case WhileStatement(condition, inner):
            return WhileStatement(rebuilt(condition, change), body(inner))
        case WhenStatement(branches):
            return WhenStatement(tuple((rebuilt(c, change), body(b)) for c, b in branches))
        case ReinitStatement(state, value):
            return ReinitStatement(target(state), rebuilt(value, change))
        case AssertStatement(condition, message):
            return AssertStatement(rebuilt(condition, change), message)
        case Refused():
            return s
