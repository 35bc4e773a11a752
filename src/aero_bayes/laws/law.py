"""Laws read from Modelica: every model that extends a partial one of ``Laws.Interfaces``, whoever wrote it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Literal

from aero_bayes.errors import InputError
from aero_bayes.export.library import modelica_root
from aero_bayes.language.base_classes import inline_base_classes
from aero_bayes.language.classes import ClassText, ComponentDeclaration, annotation_arguments, snake_case
from aero_bayes.language.dimensions import dimension, in_base_units_if_scaled, unit_factors, unit_text
from aero_bayes.language.parse import parse_expression
from aero_bayes.language.sources import modelica_files, sources_in
from aero_bayes.language.syntax import Expression, Text, arguments_of, names_in
from aero_bayes.language.tokens import Token
from aero_bayes.language.values import evaluate_expression

Kind = Literal[
    "input", "output", "reading", "motion", "storage", "overflow", "exchange", "electrical", "replaceable"
]  # fmt: skip
Attribute = Literal["default", "minimum", "maximum", "nominal"]


@dataclass(frozen=True)
class Shape:
    """What the partial model of a kind of law is given and gives.

    ``acts`` is the output that enters the model, ``given`` the inputs, ``sizes`` the size of each signal.
    """

    kind: Kind
    acts: str
    given: tuple[str, ...]
    sizes: Mapping[str, str]


SHAPES: Mapping[str, Shape] = {
    "InputLaw": Shape("input", "y", ("u",), {"u_n": "u"}),
    "OutputLaw": Shape("output", "y", ("u",), {"u_n": "u"}),
    "ReadingLaw": Shape("reading", "y", ("u",), {"u_n": "u"}),
    "MotionLaw": Shape("motion", "f", ("v", "x"), {"f_n": "f", "v_n": "v", "x_n": "x", "x_w": "x", "x_0": "x"}),
    "StorageLaw": Shape("storage", "q", ("h", "h_s"), {"q_n": "q", "h_n": "h", "h_0": "h", "h_z": "h"}),
    "OverflowLaw": Shape("overflow", "q", ("h",), {"q_n": "q", "h_n": "h"}),
    "ExchangeLaw": Shape("exchange", "q", ("h_1", "h_2"), {"q_n": "q", "h_n": "h_1", "d_n": "h_1"}),
    "SeriesLaw": Shape("electrical", "v", ("i",), {"v_n": "v", "i_n": "i"}),
}

#: Given signals that a port need not have, and the size that stands for them there.
STANDING: Mapping[str, str] = {"h_s": "h_0"}


@dataclass(frozen=True)
class LawParameter:
    """A parameter that is fitted. Its attributes are expressions in the sizes of the port.

    ``nominal`` is the magnitude at which a search starts. ``own_unit`` is the unit that its declaration gives, if any.
    """

    name: str
    description: str
    default: Expression
    minimum: Expression | None
    maximum: Expression | None
    nominal: Expression
    own_unit: str = ""

    def value(self, of: Attribute, sizes: Mapping[str, float]) -> float:
        """One of its attributes in numbers; a bound that is not given is infinite."""
        term = getattr(self, of)
        if term is None:
            return float("-inf") if of == "minimum" else float("inf")
        return evaluate_expression(term, sizes)

    def unit(self, of_size: Mapping[str, str]) -> str:
        """Unit by the units of the port's sizes, where it gives none of its own; empty where they do not tell."""
        if self.own_unit:
            return self.own_unit
        if not names_in(self.nominal):
            return "1"
        factors = {name: unit_factors(unit) for name, unit in of_size.items()}
        return unit_text(in_base_units_if_scaled(dimension(self.nominal, factors.get)))


@dataclass(frozen=True)
class Law:
    """A law: ``id`` in snake case, the kind of port it fits, its class and its parameters, the switch first.

    ``sizes`` are the parameters that the program sets, with their defaults. ``uses`` names those of the given
    signals that the equations contain; ``needs_unit`` the unit of a signal where the law asks for one; ``not_for``
    units of a signal, with spaces, where it makes no sense. ``learned`` is the signal over which it learns a curve,
    where it is no law of its own: linear in its parameters, and tried last; ``threshold`` the parameter whose value
    decides from where on it acts at all, where that is not plain from its being the only one.
    ``widths`` are parameters that are not fitted, such as the width of a rounding, where they can be set from outside.
    ``constraint`` is the class that it extends, of a law for replaceable models.
    """

    id: str
    kind: Kind
    model: str
    description: str
    parameters: tuple[LawParameter, ...]
    sizes: Mapping[str, float]
    uses: frozenset[str]
    needs_unit: Mapping[str, str]
    not_for: str
    refines: str
    learned: str
    threshold: str
    shape: Shape
    text: str
    cls: ClassText = field(repr=False, compare=False)
    widths: Mapping[str, float] = field(default_factory=dict)
    constraint: str = ""

    @cached_property
    def derived(self) -> frozenset[str]:
        """Names whose derivative its equations take."""
        return frozenset(self.cls.derived())

    @property
    def moves(self) -> bool:
        """Whether it has states of its own."""
        return bool(self.derived - set(self.shape.given))

    @property
    def takes_rate(self) -> bool:
        """Whether it needs the derivative of a signal that it is given."""
        return bool(self.derived & set(self.shape.given))

    @property
    def switch(self) -> LawParameter:
        """The parameter whose default switches the law off."""
        return self.parameters[0]


@cache
def general_laws() -> tuple[Law, ...]:
    """The laws of the shipped package ``Laws``."""
    return laws_of([modelica_root() / "Laws"])


def laws_of(sources: Sequence[Path]) -> tuple[Law, ...]:
    """Read the laws of Modelica packages, in the order of their files and classes.

    Parameters
    ----------
    sources : sequence of Path
        ``.mo`` files or package folders. The partial models of the shipped package ``Laws`` need not be among them.

    Raises
    ------
    InputError
        For a law that has no fitted parameter, or an attribute that is no formula in sizes; names file and class.
    """
    own = list(modelica_files(sources))
    known = sources_in([*modelica_files([modelica_root() / "Laws" / "Interfaces"]), *own])
    by_name = {cls.name: cls for _, cls in reversed([*known.by_name.values()])}
    found = []
    for path in own:
        file = known.files[str(path)]
        for cls in (c for top in file.classes for c in top.walk()):
            partial = _partial(cls, by_name)
            if partial is None or cls.name in SHAPES or cls.partial:
                continue
            try:
                if [b for b in cls.bases() if b.rpartition(".")[2] != partial]:
                    raise InputError(f"a law extends Laws.Interfaces.{partial} itself and nothing else")
                whole, merged = inline_base_classes(known, file, cls)
                base = known.find(f"Laws.Interfaces.{partial}")[1]
                found.append(_law(cls, SHAPES[partial], base, whole.text, merged))
            except InputError as error:
                raise InputError(f"{path}: {cls.full_name}: {error}") from None
    return tuple(found)


def _partial(cls: ClassText, known: Mapping[str, ClassText]) -> str | None:
    """Name of the partial model that a class extends, directly or through others."""
    waiting, seen = list(cls.bases()), set[str]()
    while waiting:
        name = waiting.pop().rpartition(".")[2]
        if name in SHAPES:
            return name
        if name in known and name not in seen:
            seen.add(name)
            waiting += known[name].bases()
    return None


def _law(cls: ClassText, shape: Shape, base: ClassText, text: str, merged: ClassText) -> Law:
    own, inherited = cls.components(), base.components()
    parameters = tuple(parameter_of(c) for c in (*own, *inherited) if is_fitted(c))
    if not parameters:
        raise InputError("a law needs a parameter with the attribute nominal")
    sizes = {c.name: evaluate_expression(parse_expression(c.binding), {}) for c in inherited if _is_size(c)}
    for p in parameters:
        for term in (p.default, p.minimum, p.maximum, p.nominal):
            if term is not None:
                evaluate_expression(term, dict.fromkeys(sizes, 1.0) | {"h_z": 0.0})
    words = {t.word for s in cls.equations for t in s.tokens if t.kind == "name"}
    words |= {t.word for c in own for t in c.binding if t.kind == "name"}
    (extends,) = (s for s in cls.declarations if s.first == "extends")
    modified = arguments_of(parse_expression(extends.core[1:]))
    units = {signal: unit for signal, given in modified.items() if (unit := _text(arguments_of(given).get("unit")))}
    return Law(
        snake_case(cls.name), shape.kind, cls.full_name, cls.description, parameters, sizes,
        frozenset(words & set(shape.given)), units, noted(cls.annotation, "not_for"), noted(cls.annotation, "refines"),
        noted(cls.annotation, "learned"), noted(cls.annotation, "threshold"),
        shape, text, merged,
    )  # fmt: skip


def is_fitted(c: ComponentDeclaration) -> bool:
    """Whether a declaration is a parameter that is fitted: one with a nominal value."""
    return "parameter" in c.prefixes and not c.prefixes & {"final", "protected"} and any(
        name == "nominal" for name, _ in c.modifiers
    )  # fmt: skip


def _is_size(c: ComponentDeclaration) -> bool:
    return "parameter" in c.prefixes and not c.prefixes & {"final", "protected"} and not is_fitted(c)


def parameter_of(c: ComponentDeclaration) -> LawParameter:
    """A declaration as a parameter that is fitted. Raises InputError for one without a default."""
    terms = {name: parse_expression(tokens) for name, tokens in c.modifiers}
    if not c.binding:
        raise InputError(f"the parameter {c.name!r} needs a default")
    return LawParameter(
        c.name, c.description, parse_expression(c.binding), terms.get("min"), terms.get("max"), terms["nominal"],
        _text(terms.get("unit")),
    )  # fmt: skip


def noted(annotation: Sequence[Token], word: str) -> str:
    """What an annotation says of a law, such as ``refines = "coulomb_friction"``; empty where it does not."""
    return _text(annotation_arguments(annotation, "__aero_bayes").get(word))


def _text(tree: Expression | None) -> str:
    return tree.value if isinstance(tree, Text) else ""
