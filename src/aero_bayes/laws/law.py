"""Laws read from Modelica. A law is a model that extends a partial model of ``Laws.Interfaces``, in any package."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Literal

from aero_bayes.errors import InputError
from aero_bayes.modelica.classes import ClassText, ComponentDeclaration, annotation_arguments, snake_case
from aero_bayes.modelica.graphs import reachable
from aero_bayes.modelica.library import modelica_root
from aero_bayes.modelica.parse import Token, evaluate_expression, parse_expression
from aero_bayes.modelica.sources import inline_base_classes, modelica_files, sources_in
from aero_bayes.modelica.syntax import Expression, Text, arguments_of, names_in
from aero_bayes.modelica.units import dimension, in_base_units_if_scaled, unit_factors, unit_text
from aero_bayes.simulation.model_description import Memory, memory_named

LawKind = Literal["input", "output", "reading", "motion", "storage", "overflow", "exchange", "electrical"]


@dataclass(frozen=True)
class LawInterface:
    """The inputs and the output of a partial model that laws of one kind extend."""

    kind: LawKind
    output: str
    inputs: tuple[str, ...]
    nominals: Mapping[str, str]


LAW_INTERFACES: Mapping[str, LawInterface] = {
    "InputLaw": LawInterface("input", "y", ("u",), {"u_n": "u"}),
    "OutputLaw": LawInterface("output", "y", ("u",), {"u_n": "u"}),
    "ReadingLaw": LawInterface("reading", "y", ("u",), {"u_n": "u"}),
    "MotionLaw": LawInterface(
        "motion", "f", ("v", "x", "load"), {"f_n": "f", "v_n": "v", "x_n": "x", "x_w": "x", "x_0": "x"}
    ),
    "StorageLaw": LawInterface("storage", "q", ("h", "h_s"), {"q_n": "q", "h_n": "h", "h_0": "h", "h_z": "h"}),
    "OverflowLaw": LawInterface("overflow", "q", ("h",), {"q_n": "q", "h_n": "h"}),
    "ExchangeLaw": LawInterface("exchange", "q", ("h_1", "h_2"), {"q_n": "q", "h_n": "h_1", "d_n": "h_1"}),
    "SeriesLaw": LawInterface("electrical", "v", ("i",), {"v_n": "v", "i_n": "i"}),
}

#: What the name of a parameter begins with that moves the start of a state of the law.
START_PREFIX = "start_"
#: How many parameters a law has by how it remembers its input, beside the start.
MEMORY_PARAMETERS: Mapping[Memory, int] = {"rate_limit": 1, "play": 2, "delay": 1}
#: Inputs that a port need not have, and the nominal value that replaces each one there.
SIGNAL_DEFAULTS: Mapping[str, str] = {"h_s": "h_0"}


@dataclass(frozen=True)
class LawParameter:
    """A parameter that is fitted.

    ``terms`` are its default and its attributes ``min``, ``max`` and ``nominal``, as far as they are declared, in the
    nominal values of the port; at ``nominal`` a search starts."""

    name: str
    description: str
    terms: Mapping[str, Expression]
    declared_unit: str = ""

    def value(self, of: str, nominals: Mapping[str, float]) -> float:
        """Return the number of the default or an attribute."""
        return evaluate_expression(self.terms[of], nominals)

    def unit(self, nominal_units: Mapping[str, str]) -> str:
        """Return the declared unit; else the one that follows from the units of the nominal values.

        Empty if unknown."""
        if self.declared_unit:
            return self.declared_unit
        if not names_in(self.terms["nominal"]):
            return "1"
        factors = {name: unit_factors(unit) for name, unit in nominal_units.items()}
        return unit_text(in_base_units_if_scaled(dimension(self.terms["nominal"], factors.get)))


@dataclass(frozen=True)
class Law:
    """A physical law that may be missing in a model, such as Coulomb friction, read from a Modelica class.

    ``further_inputs`` are those that its own class declares: it reads variables of these names beside the signal of a
    port."""

    id: str
    kind: LawKind
    model: str
    description: str
    parameters: tuple[LawParameter, ...]
    nominals: Mapping[str, float]
    used_inputs: frozenset[str]
    required_units: Mapping[str, str]
    excluded_units: str
    refines: str
    curve_input: str
    threshold: str
    interface: LawInterface
    text: str
    cls: ClassText = field(repr=False, compare=False)
    both_signs: str = ""
    nonnegative: str = ""
    delay: str = ""
    memory: Memory = ""
    absolute: str = ""
    starts: tuple[LawParameter, ...] = ()
    further_inputs: tuple[str, ...] = ()

    @cached_property
    def differentiated(self) -> frozenset[str]:
        """Names whose time derivative occurs in its equations."""
        return frozenset(self.cls.derived())

    @property
    def has_states(self) -> bool:
        """Whether it has states of its own."""
        return bool(self.differentiated - set(self.interface.inputs))

    @property
    def needs_derivative(self) -> bool:
        """Whether it needs the time derivative of an input."""
        return bool(self.differentiated & set(self.interface.inputs))

    @property
    def magnitude(self) -> LawParameter:
        """The parameter whose default switches the law off."""
        return self.parameters[0]


@cache
def shipped_laws() -> tuple[Law, ...]:
    """Return the laws of the shipped package ``Laws``."""
    return read_laws([modelica_root() / "Laws"])


def read_laws(sources: Sequence[Path]) -> tuple[Law, ...]:
    """Read the laws of Modelica packages, in the order of their files and classes."""
    own = list(modelica_files(sources))
    known = sources_in([*modelica_files([modelica_root() / "Laws" / "Interfaces"]), *own])
    by_name = {cls.name: cls for _, cls in reversed([*known.by_name.values()])}
    found = []
    for path in own:
        file = known.files[str(path)]
        for cls in (c for top in file.classes for c in top.walk()):
            partial = _partial_model(cls, by_name)
            if partial is None or cls.name in LAW_INTERFACES or cls.partial:
                continue
            try:
                if [b for b in cls.bases() if b.rpartition(".")[2] != partial]:
                    raise InputError(f"a law extends Laws.Interfaces.{partial} itself and nothing else")
                whole, merged = inline_base_classes(known, file, cls)
                base = known.find(f"Laws.Interfaces.{partial}")[1]
                found.append(_law(cls, LAW_INTERFACES[partial], base, whole.text, merged))
            except InputError as error:
                raise InputError(f"{path}: {cls.full_name}: {error}") from None
    return tuple(found)


def _partial_model(cls: ClassText, known: Mapping[str, ClassText]) -> str | None:
    """Return the name of the partial model that a class extends, directly or through others."""

    def bases(of: ClassText | None) -> list[str]:
        return [name.rpartition(".")[2] for name in of.bases()] if of is not None else []

    return next((n for n in reachable(bases(cls), lambda n: bases(known.get(n))) if n in LAW_INTERFACES), None)


def _law(cls: ClassText, interface: LawInterface, base: ClassText, text: str, merged: ClassText) -> Law:
    own, inherited = cls.components(), base.components()
    further = tuple(c.name for c in own if "input" in c.prefixes)
    interface = replace(interface, inputs=(*interface.inputs, *further))
    fitted = [law_parameter(c) for c in (*own, *inherited) if is_fitted_parameter(c)]
    parameters = tuple(p for p in fitted if not p.name.startswith(START_PREFIX))
    if not parameters:
        raise InputError("a law needs a parameter with the attribute nominal")
    nominals = {c.name: evaluate_expression(parse_expression(c.binding), {}) for c in inherited if _is_nominal(c)}
    for p in fitted:
        for of in p.terms:  # InputError for what is no expression in nominal values
            p.value(of, dict.fromkeys(nominals, 1.0) | {"h_z": 0.0})
    words = {t.word for s in cls.equations for t in s.tokens if t.kind == "name"}
    words |= {t.word for c in own for t in c.binding if t.kind == "name"}
    (extends,) = (s for s in cls.declarations if s.first == "extends")
    modified = arguments_of(parse_expression(extends.core[1:]))
    units = {signal: unit for signal, given in modified.items() if (unit := _text(arguments_of(given).get("unit")))}
    memory = memory_named(annotation_text(cls.annotation, "memory"))
    if memory and (memory == "delay") != (interface.kind in ("output", "reading")):
        raise InputError(f"no law of this kind has the memory {memory!r}")
    if memory and len(parameters) != MEMORY_PARAMETERS[memory]:
        raise InputError(
            f"a law with the memory {memory!r} has {MEMORY_PARAMETERS[memory]} parameters beside its start"
        )
    return Law(
        id=snake_case(cls.name),
        kind=interface.kind,
        model=cls.full_name,
        description=cls.description,
        parameters=parameters,
        nominals=nominals,
        used_inputs=frozenset(words & set(interface.inputs)),
        required_units=units,
        excluded_units=annotation_text(cls.annotation, "not_for"),
        refines=annotation_text(cls.annotation, "refines"),
        curve_input=annotation_text(cls.annotation, "learned"),
        threshold=annotation_text(cls.annotation, "threshold"),
        both_signs=annotation_text(cls.annotation, "both_signs"),
        nonnegative=annotation_text(cls.annotation, "nonnegative"),
        delay=annotation_text(cls.annotation, "delay"),
        memory=memory,
        absolute=annotation_text(cls.annotation, "absolute"),
        interface=interface,
        text=text,
        cls=merged,
        starts=tuple(p for p in fitted if p not in parameters),
        further_inputs=further,
    )


def is_fitted_parameter(c: ComponentDeclaration) -> bool:
    """Return whether a declaration is a fitted parameter: one with the attribute ``nominal``."""
    return "parameter" in c.prefixes and not c.prefixes & {"final", "protected"} and any(
        name == "nominal" for name, _ in c.modifiers
    )  # fmt: skip


def _is_nominal(c: ComponentDeclaration) -> bool:
    return "parameter" in c.prefixes and not c.prefixes & {"final", "protected"} and not is_fitted_parameter(c)


def law_parameter(c: ComponentDeclaration) -> LawParameter:
    """Return the fitted parameter of a declaration. Raises InputError if it has no default."""
    if not c.binding:
        raise InputError(f"the parameter {c.name!r} needs a default")
    given = {name: parse_expression(tokens) for name, tokens in (("default", c.binding), *c.modifiers)}
    terms: dict[str, Expression] = {k: given[k] for k in ("default", "min", "max", "nominal") if k in given}
    return LawParameter(c.name, c.description, terms, _text(given.get("unit")))


def annotation_text(annotation: Sequence[Token], word: str) -> str:
    """Return the text of an entry in ``__aero_bayes`` of an annotation, such as ``refines``. Empty if there is none."""
    return _text(annotation_arguments(annotation, "__aero_bayes").get(word))


def _text(tree: Expression | None) -> str:
    return tree.value if isinstance(tree, Text) else ""
