"""Syntax trees of Modelica: expressions, and the statements of algorithms."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields, replace
from typing import Any


@dataclass(frozen=True)
class SyntaxNode:
    """An expression; ``span`` is where it begins and ends in the text that it was read from."""

    span: tuple[int, int] = field(default=(0, 0), compare=False, repr=False, kw_only=True)


@dataclass(frozen=True)
class Number(SyntaxNode):
    """A literal; Booleans are 0 and 1, enumeration literals their ordinals."""

    value: float


@dataclass(frozen=True)
class Name(SyntaxNode):
    """A component reference; ``subscripts`` of its last part, if any."""

    name: str
    subscripts: tuple[Expression, ...] = ()


@dataclass(frozen=True)
class Text(SyntaxNode):
    """A string literal, without its quotation marks."""

    value: str


@dataclass(frozen=True)
class Call(SyntaxNode):
    """A function call, or an operator by its symbol."""

    function: str
    args: tuple[Expression, ...]


@dataclass(frozen=True)
class If(SyntaxNode):
    """``if condition then then else otherwise``, as an expression."""

    condition: Expression
    then: Expression
    otherwise: Expression


@dataclass(frozen=True)
class Array(SyntaxNode):
    """Elements of an array, fields of a record, or results of a function with several."""

    items: tuple[Expression, ...]


@dataclass(frozen=True)
class Comprehension(SyntaxNode):
    """``{item for variable in values}``."""

    item: Expression
    variable: str
    values: Expression


@dataclass(frozen=True)
class RangeExpression(SyntaxNode):
    """``first:step:last``; ``step`` is None where it is left out."""

    first: Expression
    step: Expression | None
    last: Expression


@dataclass(frozen=True)
class Index(SyntaxNode):
    """An element of something that is not a plain name, such as ``der(x)[2]``."""

    of: Expression
    subscripts: tuple[Expression, ...]


@dataclass(frozen=True)
class Field(SyntaxNode):
    """A field of a record that is not a plain name, such as ``f(x).re``."""

    of: Expression
    name: str


@dataclass(frozen=True)
class NamedArgument(SyntaxNode):
    """An argument that is given by its name: ``f(x = 1)``."""

    name: str
    value: Expression


@dataclass(frozen=True)
class WholeDimension(SyntaxNode):
    """The subscript ``:``."""


Expression = (
    Number
    | Name
    | Text
    | Call
    | If
    | Array
    | Comprehension
    | RangeExpression
    | Index
    | Field
    | NamedArgument
    | WholeDimension
)


@dataclass(frozen=True)
class Assign:
    """``targets := value``; several targets for a function with several results, None where one is left out."""

    targets: tuple[Name | None, ...]
    value: Expression


@dataclass(frozen=True)
class IfStatement:
    """``if`` with its ``elseif`` branches in order; ``otherwise`` is the ``else`` branch."""

    branches: tuple[tuple[Expression, tuple[Statement, ...]], ...]
    otherwise: tuple[Statement, ...]


@dataclass(frozen=True)
class ForStatement:
    """``for variable in values loop``."""

    variable: str
    values: Expression
    body: tuple[Statement, ...]


@dataclass(frozen=True)
class WhileStatement:
    """``while condition loop``."""

    condition: Expression
    body: tuple[Statement, ...]


@dataclass(frozen=True)
class WhenStatement:
    """``when`` with its ``elsewhen`` branches in order."""

    branches: tuple[tuple[Expression, tuple[Statement, ...]], ...]


@dataclass(frozen=True)
class ReinitStatement:
    """``reinit(state, value)``."""

    state: Name
    value: Expression


@dataclass(frozen=True)
class AssertStatement:
    """``assert(condition, message)``."""

    condition: Expression
    message: str


@dataclass(frozen=True)
class UnsupportedStatement:
    """A statement that cannot be translated: an error once it is needed, not where a function merely has it."""

    what: str


Statement = (
    Assign
    | IfStatement
    | ForStatement
    | WhileStatement
    | WhenStatement
    | ReinitStatement
    | AssertStatement
    | UnsupportedStatement
)


def short_text(tree: Expression) -> str:
    """Return a short text for messages."""
    match tree:
        case Name(name, subscripts):
            return name + (f"[{','.join(map(short_text, subscripts))}]" if subscripts else "")
        case Number(value):
            return f"{value:g}"
        case Call(function, args):
            return f"{function}({', '.join(map(short_text, args))})"
        case WholeDimension():
            return ":"
    return type(tree).__name__.lower()


_BINDING = {"+": 1, "-": 1, "*": 2, "/": 2, "^": 3}


def modelica_text(tree: Expression, binds: int = 0) -> str | None:
    """Return a formula of names, numbers, operators and functions as Modelica; None for anything else.

    It stands in parentheses where what is around it ``binds`` more than its own operator."""
    match tree:
        case Name():
            return short_text(tree)
        case Number(value):
            return f"{value:.12g}" if value >= 0.0 else f"({value:.12g})"
        case Call("+" | "-" | "*" | "/" | "^" as operator, (one, two)):
            own = _BINDING[operator]
            left = modelica_text(one, own + (operator == "^"))
            right = modelica_text(two, own + (operator != "+"))
            text = None if left is None or right is None else f"{left} {operator} {right}"
            return f"({text})" if text is not None and binds > own else text
        case Call("neg", (one,)):
            inner = modelica_text(one, _BINDING["*"])
            return None if inner is None else f"(-{inner})"
        case Call(function, args) if function.replace(".", "").isidentifier():
            given = [text for a in args if (text := modelica_text(a)) is not None]
            return f"{function}({', '.join(given)})" if len(given) == len(args) else None
    return None


def children(tree: Expression) -> tuple[Expression, ...]:
    """Return the expressions directly below one."""
    found: list[Expression] = []
    for name in tree.__match_args__:
        part = getattr(tree, name)
        found += part if isinstance(part, tuple) else (part,) if isinstance(part, Expression) else ()
    return tuple(found)


def arguments_of(tree: Expression) -> dict[str, Expression]:
    """Return the arguments of a call that are given by name, calls among them by the names of their functions."""
    found: dict[str, Expression] = {}
    for a in children(tree):
        if isinstance(a, NamedArgument):
            found[a.name] = a.value
        elif isinstance(a, Call):
            found.setdefault(a.function, a)
    return found


def walk(tree: Expression) -> Iterator[Expression]:
    """Yield an expression and all that it is made of."""
    yield tree
    for inner in children(tree):
        yield from walk(inner)


def summands(tree: Expression) -> list[tuple[int, Expression]]:
    """Return the terms that an expression adds up, each with its sign; itself where it is no sum."""
    match tree:
        case Call("+" | ".+", (one, two)):
            return [*summands(one), *summands(two)]
        case Call("-" | ".-", (one, two)):
            return [*summands(one), *((-sign, t) for sign, t in summands(two))]
        case Call("neg", (one,)):
            return [(-sign, t) for sign, t in summands(one)]
    return [(1, tree)]


#: Operators that divide, as numbers or element by element.
DIVIDES = frozenset({"/", "./"})
_INVERSE = {"*": "/", "/": "*", ".*": "./", "./": ".*"}


def factors(tree: Expression) -> list[tuple[str, Expression]]:
    """Return the factors of an expression, each with the operator before it; itself where it is no product."""
    match tree:
        case Call("*" | ".*" | "/" | "./" as operator, (one, two)):
            first, *others = factors(two)
            others = [(_INVERSE[o], t) for o, t in others] if operator in DIVIDES else others
            return [*factors(one), (operator, first[1]), *others]
        case Call("neg", (one,)):
            return [("*", Number(-1.0)), *factors(one)]
    return [("*", tree)]


def parse_reference(name: str) -> Name:
    """Return a variable by its name; ``x[1]`` is an element of ``x``."""
    base, bracket, inside = name.partition("[")
    if not bracket or not name.endswith("]") or "." in inside:
        return Name(name)
    return Name(base, tuple(Number(float(k)) for k in inside[:-1].split(",")))


def names_in(tree: Expression) -> set[str]:
    """Return the names that an expression refers to."""
    found: set[str] = set()
    stack = [tree]
    while stack:
        item = stack.pop()
        if isinstance(item, Name):
            found.add(item.name)
        stack.extend(children(item))
    return found


def map_children(tree: Expression, change: Callable[[Expression], Expression]) -> Expression:
    """Return a copy in which each expression directly below is what ``change`` makes of it."""

    def changed(part: Any) -> Any:
        if isinstance(part, tuple):
            return tuple(map(change, part))
        return part if part is None or isinstance(part, str) else change(part)

    make: Callable[..., Expression] = type(tree)
    return make(*(changed(getattr(tree, name)) for name in tree.__match_args__)) if children(tree) else tree


def map_names(tree: Expression, change: Callable[[Name], Expression]) -> Expression:
    """Return a copy in which each name (its subscripts already rebuilt) is what ``change`` makes of it."""
    if isinstance(tree, Comprehension):
        # the loop variable hides a variable of that name
        inner = map_names(tree.item, lambda n: n if n.name == tree.variable else change(n))
        return Comprehension(inner, tree.variable, map_names(tree.values, change))
    whole = map_children(tree, lambda t: map_names(t, change))
    return change(whole) if isinstance(whole, Name) else whole


def map_names_in_statement(s: Statement, change: Callable[[Name], Expression]) -> Statement:
    """Return a copy of a statement: expressions by ``change``, what is assigned as it is."""

    def changed(part: Any) -> Any:
        if isinstance(part, tuple):
            return tuple(map(changed, part))
        if isinstance(part, Statement):
            return map_names_in_statement(part, change)
        return map_names(part, change) if isinstance(part, Expression) else part

    assigned = {ReinitStatement: "state", Assign: "targets"}.get(type(s))
    return replace(s, **{f.name: changed(getattr(s, f.name)) for f in fields(s) if f.name != assigned})
