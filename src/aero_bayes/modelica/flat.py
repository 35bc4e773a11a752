"""The flat model: a Modelica model's variables, equations and events without its hierarchy, and where each is from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Literal

from aero_bayes.modelica.parse import SourceLocation
from aero_bayes.modelica.syntax import Expression, Statement, WhenStatement

Variability = Literal["continuous", "discrete", "parameter", "constant"]
Causality = Literal["local", "input", "output"]
Origin = Literal["component", "connection", "flow", "binding", "added"]


def element_names(name: str, sizes: Sequence[int]) -> list[str]:
    """``x[1]``, ``x[2]``, ... row by row; none for a scalar."""
    return [f"{name}[{','.join(map(str, k))}]" for k in product(*(range(1, n + 1) for n in sizes))] if sizes else []


@dataclass(frozen=True)
class FlatVariable:
    """One variable, maybe an array."""

    name: str
    type: str = "Real"
    variability: Variability = "continuous"
    causality: Causality = "local"
    sizes: tuple[int, ...] = ()
    unit: str = ""
    attributes: Mapping[str, Expression] = field(default_factory=dict)
    binding: Expression | None = None
    flow: bool = False
    state_select: str = "default"
    protected: bool = False
    final: bool = False
    description: str = ""
    place: SourceLocation | None = None

    @property
    def constant(self) -> bool:
        """A parameter or a constant."""
        return self.variability in ("parameter", "constant")

    @property
    def value(self) -> Expression | None:
        """What a parameter is bound to, or else its start value."""
        return self.binding if self.binding is not None else self.attributes.get("start")

    @property
    def scalar_names(self) -> list[str]:
        """Names of its elements, its own one if it is a scalar."""
        return element_names(self.name, self.sizes) or [self.name]


@dataclass(frozen=True)
class FlatEquation:
    """``left = right``; arrays element by element.

    ``component`` is the instance whose class states it; for a connection and a sum of flows the instance that holds
    the connectors. ``place`` of these two is where the connector declares the variable."""

    left: Expression
    right: Expression
    origin: Origin = "component"
    component: str = ""
    place: SourceLocation | None = None


@dataclass(frozen=True)
class When:
    """A when equation with its elsewhen branches; what it assigns is true at once, in whatever order it is written."""

    statement: WhenStatement
    place: SourceLocation | None = None


@dataclass(frozen=True)
class Assertion:
    """A condition that should hold, and the message where it does not."""

    condition: Expression
    message: str
    place: SourceLocation | None = None


@dataclass(frozen=True)
class Algorithm:
    """Statements in order, and the variables that they assign."""

    statements: tuple[Statement, ...]
    outputs: tuple[str, ...]
    place: SourceLocation | None = None


@dataclass(frozen=True)
class Argument:
    """A variable of a function; ``sizes`` is None where they follow from the call."""

    name: str
    sizes: tuple[Expression, ...]
    default: Expression | None
    type: str = "Real"


@dataclass(frozen=True)
class Function:
    """A function of the model: its variables and the statements of its algorithm.

    ``constructor`` marks the constructor of a record; ``external`` is the name of an external C function."""

    name: str
    inputs: tuple[Argument, ...]
    outputs: tuple[Argument, ...]
    locals: tuple[Argument, ...]
    body: tuple[Statement, ...]
    constructor: bool = False
    external: str = ""


@dataclass(frozen=True)
class FlatModel:
    """What a compiler's front end makes of a model; ``records`` names the fields
    of record variables, and of record types, in order; ``literals`` are those of enumerations with their ordinals.
    """

    name: str
    variables: tuple[FlatVariable, ...] = ()
    equations: tuple[FlatEquation, ...] = ()
    initial_equations: tuple[FlatEquation, ...] = ()
    algorithms: tuple[Algorithm, ...] = ()
    initial_algorithms: tuple[Algorithm, ...] = ()
    whens: tuple[When, ...] = ()
    assertions: tuple[Assertion, ...] = ()
    functions: Mapping[str, Function] = field(default_factory=dict)
    records: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    description: str = ""
    literals: Mapping[str, int] = field(default_factory=dict)

    def variable(self, name: str) -> FlatVariable:
        """Return the variable of that name. Raises KeyError where there is none."""
        for v in self.variables:
            if v.name == name:
                return v
        raise KeyError(name)
