"""The syntax tree of flat Modelica: expressions, statements, equations, declarations."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Number:
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


Expression = Number | Name | Text | Call | If | Array | Comprehension | Range | Index


@dataclass(frozen=True)
class Assign:
    target: Name
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


Statement = Assign | IfStatement | ForStatement


@dataclass(frozen=True)
class Equal:
    """An equation; both sides may be arrays."""

    left: Expression
    right: Expression


@dataclass(frozen=True)
class ForEquation:
    variable: str
    values: Expression
    body: tuple[Equation, ...]


Equation = Equal | ForEquation


@dataclass(frozen=True)
class Declaration:
    """One declared variable: ``prefixes`` such as parameter or input, its type, sizes, attributes and binding."""

    name: str
    type: str
    prefixes: frozenset[str]
    sizes: tuple[Expression, ...]
    attributes: dict[str, Expression]
    binding: Expression | None
    description: str


@dataclass(frozen=True)
class Function:
    name: str
    declarations: tuple[Declaration, ...]
    body: tuple[Statement, ...]


@dataclass(frozen=True)
class FlatModel:
    name: str
    declarations: tuple[Declaration, ...] = ()
    equations: tuple[Equation, ...] = ()
    initial_equations: tuple[Equation, ...] = ()
    functions: dict[str, Function] = field(default_factory=dict)
