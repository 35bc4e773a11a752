"""Formulas: terms that the library does not list, as products of functions of the signals that a port knows.

A formula is added to a balance, an input or an output, or makes a function of a parameter. It becomes a law like any
other, written in Modelica, with a fitted coefficient and at most one fitted constant inside. So it is composed,
simulated, fitted and written into a model by the ways that listed laws go.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations, permutations
from typing import Literal

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.language.class_reader import read_classes
from aero_bayes.language.classes import ClassText
from aero_bayes.language.parse import parse_expression
from aero_bayes.language.values import evaluate_expression
from aero_bayes.laws.law import Law, LawInterface, is_fitted_parameter, law_parameter
from aero_bayes.laws.placed_law import PlacedLaw
from aero_bayes.ports import Port

#: What a formula does: it is added; it is the share by which a parameter grows; or a parameter goes with a power of a
#: signal, whose exponent is fitted.
Way = Literal["added", "share", "power"]

#: What the law of every formula is called; a number follows where several are tried.
FORMULA = "formula"
#: What a formula of a parameter is called while it is tried.
FUNCTION = "function"
#: Largest magnitude of a coefficient, and the one that a search starts from, in the largest term of the balance over
#: the largest value of the product: a missing term is seldom much larger than those that are there.
MAX_COEFFICIENT, START_COEFFICIENTS = 100.0, (0.3, 1.0)
#: Name of the state of an unknown signal.
DISTURBANCE = "d"
#: A signal counts as never passing zero where its smallest magnitude is at least this share of its largest one.
MIN_AWAY_FROM_ZERO = 0.02


@dataclass(frozen=True)
class Shape:
    """A function of one signal."""

    text: str
    value: Callable[[FloatArray, float, float], FloatArray]
    power: float = 0.0
    needs: str = ""
    constants: tuple[float, ...] = ()

    def fits(self, low: float, high: float, unit: str) -> bool:
        """Return whether a signal in a range, with a unit, can be put in."""
        match self.needs:
            case "both":
                return low < 0.0 < high
            case "positive":
                return low >= 0.0
            case "nonzero":
                return low * high > 0.0 and min(abs(low), abs(high)) >= MIN_AWAY_FROM_ZERO * max(abs(low), abs(high))
            case "positive nonzero":
                return low >= MIN_AWAY_FROM_ZERO * high > 0.0
            case "number":
                return unit in ("", "1", "rad")
        return True


def _shape(text: str, value: Callable[[FloatArray], FloatArray], power: float = 0.0, needs: str = "") -> Shape:
    return Shape(text, lambda s, a, n: value(s), power, needs)


_SCALES = (0.1, 0.3, 1.0, 3.0)
SIGNAL = _shape("{s}", lambda s: s, 1.0)
SQUARE = _shape("{s} ^ 2", lambda s: s**2, 2.0)
CUBE = _shape("{s} ^ 3", lambda s: s**3, 3.0)
SINE = _shape("sin({s})", np.sin, needs="number")
COSINE = _shape("cos({s})", np.cos, needs="number")
LOGARITHM = _shape("log({s})", np.log, needs="positive nonzero")
DECAY = Shape("exp(-{s} / {a})", lambda s, a, n: np.exp(-s / a), constants=_SCALES)
GROWTH = Shape("exp({s} / {a})", lambda s, a, n: np.exp(s / a), constants=(0.3, 1.0, 3.0))
#: Functions that may be a factor beside another one, and those that stand alone.
FACTORS: tuple[Shape, ...] = (
    SIGNAL, SQUARE, SINE, COSINE,
    _shape("abs({s})", np.abs, 1.0, "both"),
    _shape("sqrt({s})", np.sqrt, 0.5, "positive"),
    _shape("1 / {s}", lambda s: 1.0 / s, -1.0, "nonzero"),
    Shape("1 / ({a} + {s})", lambda s, a, n: 1.0 / (a + s), -1.0, "positive", _SCALES),
    Shape("{s} / ({a} + {s})", lambda s, a, n: s / (a + s), 0.0, "positive", _SCALES),
    Shape("1 / ({a} ^ 2 + {s} ^ 2)", lambda s, a, n: 1.0 / (a**2 + s**2), -2.0, "", _SCALES),
    Shape("{s} / ({a} ^ 2 + {s} ^ 2)", lambda s, a, n: s / (a**2 + s**2), -1.0, "", _SCALES),
)  # fmt: skip
ALONE: tuple[Shape, ...] = (
    *FACTORS, CUBE, LOGARITHM, DECAY, GROWTH,
    _shape("{s} ^ 4", lambda s: s**4, 4.0),
    _shape("{s} ^ 5", lambda s: s**5, 5.0),
    _shape("{s} * abs({s})", lambda s: s * np.abs(s), 2.0, "both"),
    Shape("{s} ^ 2 / ({a} ^ 2 + {s} ^ 2)", lambda s, a, n: s**2 / (a**2 + s**2), 0.0, "", _SCALES),
    Shape("tanh({s} / {a})", lambda s, a, n: np.tanh(s / a), 0.0, "", _SCALES),
    Shape("({s} / {n}) ^ {a}", lambda s, a, n: (s / n) ** a, 0.0, "positive", (0.5, 0.66, 1.5)),
)  # fmt: skip
#: Of a parameter that goes with a power of a signal: its change is linear in the exponent, to first order.
LOGARITHM_OF_RATIO = Shape("log({s} / {n})", lambda s, a, n: np.log(s / n), 0.0, "positive nonzero")
#: Pairs of functions of one and the same signal.
SAME_SIGNAL: tuple[tuple[Shape, Shape], ...] = (
    (SINE, COSINE), (SIGNAL, LOGARITHM), (SIGNAL, DECAY), (SIGNAL, SINE), (SIGNAL, COSINE),
)  # fmt: skip


@dataclass(frozen=True)
class Signal:
    """A signal at a port: the variable, its unit, and the range that it visits."""

    name: str
    unit: str
    low: float
    high: float

    @property
    def size(self) -> float:
        return max(abs(self.low), abs(self.high)) or 1.0


@dataclass(frozen=True)
class Formula:
    """A product of functions of signals, each with its constant (0 where it has none), and what it does."""

    factors: tuple[tuple[Shape, Signal, float], ...]
    way: Way = "added"

    def values(self, signals: Mapping[str, FloatArray]) -> FloatArray:
        """Return the product over signals (n,) by name."""
        found = np.ones(1)
        for shape, signal, constant in self.factors:
            found = found * shape.value(signals[signal.name], constant, signal.size)
        return found

    @property
    def signals(self) -> tuple[Signal, ...]:
        """The signals that it reads, each once."""
        return tuple(dict.fromkeys(signal for _, signal, _ in self.factors))

    @property
    def constants(self) -> tuple[float, ...]:
        """Its constants, none or one."""
        return tuple(constant for shape, _, constant in self.factors if shape.constants)

    @property
    def form(self) -> tuple[tuple[str, str], ...]:
        """What is the same for formulas that differ by their constants."""
        return ((self.way, ""), *((shape.text, signal.name) for shape, signal, _ in self.factors))

    @property
    def complexity(self) -> int:
        """Number of its factors, of its constants, and of what is more than a product of signals.

        A parameter that grows with a function is one more factor."""
        return (self.way == "share") + sum(
            1 + bool(shape.constants) + (shape is not SIGNAL) for shape, *_ in self.factors
        )

    def text(self, names: Mapping[str, str], constant: str, sizes: Callable[[Signal], str]) -> str:
        """Write the product with other names of the signals, and of its constant."""
        parts = [
            _as_factor(shape.text, k).format(s=names[signal.name], a=constant, n=sizes(signal))
            for k, (shape, signal, _) in enumerate(self.factors)
        ]
        return "".join(parts)


def _as_factor(text: str, position: int) -> str:
    """Join a factor to those before it; ``1 / s`` divides."""
    if text.startswith("1 / "):
        return f" / {text.removeprefix('1 / ')}"
    return f" * ({text})" if " / " in text and not text.startswith(("exp(", "tanh(", "(")) else f" * {text}"


def formulas(signals: Sequence[Signal]) -> Iterator[Formula]:
    """Yield all formulas over some signals: functions of one, products of two, and products of three signals."""

    def with_constants(*pairs: tuple[Shape, Signal]) -> Iterator[Formula]:
        if not all(shape.fits(s.low, s.high, s.unit) for shape, s in pairs):
            return
        inner = [(k, shape, s) for k, (shape, s) in enumerate(pairs) if shape.constants]
        if len(inner) > 1:
            return
        plain = [(shape, s, 0.0) for shape, s in pairs]
        if not inner:
            yield Formula(tuple(plain))
        for k, shape, s in inner:
            for share in shape.constants:
                constant = share if "{n}" in shape.text else share * s.size
                yield Formula(tuple((*one[:2], constant) if j == k else one for j, one in enumerate(plain)))

    for s in signals:
        for shape in ALONE:
            yield from with_constants((shape, s))
        for one, other in SAME_SIGNAL:
            yield from with_constants((one, s), (other, s))
    for s, t in permutations(signals, 2):
        for k, one in enumerate(FACTORS):
            for other in FACTORS[k + (signals.index(s) > signals.index(t)) :]:
                yield from with_constants((one, s), (other, t))
    for three in combinations(signals, 3):
        yield from with_constants(*((SIGNAL, s) for s in three))


def parameter_formulas(signals: Sequence[Signal]) -> Iterator[Formula]:
    """Yield functions that a parameter may be: powers of a signal, and ``1 + k`` times a function of a signal."""
    for s in signals:
        if LOGARITHM_OF_RATIO.fits(s.low, s.high, s.unit):
            yield Formula(((LOGARITHM_OF_RATIO, s, 0.0),), "power")
    yield from (replace(one, way="share") for s in signals for one in formulas((s,)))


def formula_law(formula: Formula, port: Port, id_: str, largest: float, own: str = "") -> tuple[Law, Port]:
    """Return a formula as a law, and the port with the signals that it reads."""
    signals, at_signal = formula.signals, "u" in port.signals
    local = {s.name: "u" if at_signal and s.name == own else f"s_{k + 1}" for k, s in enumerate(signals)}
    powers = [f"{local[s.name]}_n ^ ({shape.power:g})" for shape, s, _ in formula.factors if shape.power]
    sized = float(np.prod([signal.size**shape.power for shape, signal, _ in formula.factors]))
    size = "q_n" if formula.way == "added" else "1"
    scale = f"{sized / (largest or 1.0):.6g} * {size}" + "".join(f" / {p}" for p in powers)
    read = {name: signal for signal, name in local.items()} | ({"u": port.signals["u"]} if at_signal else {})
    output = "y" if at_signal else "q"
    name = f"{id_[:1].upper()}{id_[1:]}"
    lines = [
        f'model {name} "{_TITLES[formula.way]} {described(formula)}"',
        '  parameter Real q_n = 1 "Typical size of the term";',
        *(f'  parameter Real {local[s.name]}_n = 1 "Typical size of {s.name}";' for s in signals),
        f"  parameter Real k(min = -{MAX_COEFFICIENT:g} * ({scale}), max = {MAX_COEFFICIENT:g} * ({scale}), "
        f'nominal = {scale}) = 0 "{"Exponent" if formula.way == "power" else "Coefficient"}";',
        *_constant(formula, local),
        *(f'  input Real {local_name} "{signal}";' for local_name, signal in read.items()),
        f'  output Real {output} "{"Quantity with the term" if at_signal else "Term"}";',
        "equation",
        f"  {_equation(formula, local, at_signal)};",
        f"end {name};",
    ]
    text = "\n".join(lines) + "\n"
    (cls,) = read_classes(text)
    sizes = {f"{local[s.name]}_n": local[s.name] for s in signals}
    interface = LawInterface("formula", output, tuple(read), {"q_n": output, **sizes})
    units = {"u": port.unit, output: port.unit, **{local[s.name]: s.unit for s in signals}}
    return _law(id_, cls, text, interface), replace(port, signals=read, units=units)


_TITLES: Mapping[Way, str] = {"added": "Term", "share": "Parameter that grows with", "power": "Parameter that goes as"}


def _constant(formula: Formula, local: Mapping[str, str]) -> list[str]:
    """Return the declaration of the constant inside of a formula, if it has one."""
    for shape, signal, start in formula.factors:
        if shape.constants:
            size = f"{local[signal.name]}_n" if "{n}" not in shape.text else "1"
            share = start / (signal.size if size != "1" else 1.0)
            return [
                f"  parameter Real a(min = {0.05 * share:.6g} * {size}, max = {20.0 * share:.6g} * {size}, "
                f'nominal = {share:.6g} * {size}) = {share:.6g} * {size} "Constant";'
            ]
    return []


def _equation(formula: Formula, local: Mapping[str, str], at_signal: bool) -> str:
    """Return the equation of a formula: off where ``k`` is zero."""
    if formula.way == "power":
        (signal,) = formula.signals
        return f"y = u * ({local[signal.name]} / {signal.size:.6g}) ^ k"
    product = formula.text(local, "a", lambda s: f"{s.size:.6g}")
    if formula.way == "share":
        return f"y = u * (1 + k{product})"
    return f"y = u + k{product}" if at_signal else f"q = k{product}"


@cache
def disturbances() -> Mapping[bool, Law]:
    """Make unknown signals as laws, by whether they act at an input or an output: each is a state that stands still."""
    found = {}
    for at_signal in (False, True):
        id_, output, inputs = ("unknown_change", "y", ("u",)) if at_signal else ("unknown_term", "q", ())
        lines = [
            f'model {id_.capitalize()} "Unknown signal"',
            *(f"  input Real {name};" for name in inputs),
            f"  output Real {output};",
            f"  Real {DISTURBANCE}(start = 0, fixed = true);",
            "equation",
            f"  der({DISTURBANCE}) = 0;",
            f"  {output} = {'u + ' if at_signal else ''}{DISTURBANCE};",
            f"end {id_.capitalize()};",
        ]
        text = "\n".join(lines) + "\n"
        (cls,) = read_classes(text)
        found[at_signal] = _law(id_, cls, text, LawInterface("formula", output, inputs, {}))
    return found


def _law(id_: str, cls: ClassText, text: str, interface: LawInterface) -> Law:
    parameters = tuple(law_parameter(c) for c in cls.components() if is_fitted_parameter(c))
    nominals = {
        c.name: evaluate_expression(parse_expression(c.binding), {})
        for c in cls.components()
        if c.name in interface.nominals
    }
    return Law(
        id=id_, kind="formula", model=cls.full_name, description=cls.description, parameters=parameters,
        nominals=nominals, used_inputs=frozenset(interface.inputs), required_units={}, excluded_units="", refines="",
        curve_input="", threshold="", interface=interface, text=text, cls=cls,
    )  # fmt: skip


def formula_starts(placed: PlacedLaw) -> tuple[tuple[float, ...], ...]:
    """Return starting values of a placed formula: coefficients of both signs, its constant as it was proposed."""
    k, *rest = placed.parameters()
    inner = tuple(placed.value(p) for p in rest)
    size = placed.limits(k)["nominal"]
    return tuple((sign * share * size, *inner) for share in START_COEFFICIENTS for sign in (1.0, -1.0))


def described(formula: Formula) -> str:
    """Return the product for a reader, its constant as ``a``; of a power its signal."""
    return f"a power of {formula.signals[0].name}" if formula.way == "power" else _readable(formula, "a")


def told(formula: Formula, coefficient: float, constant: float = 0.0, *, parameter: str = "") -> str:
    """Return a formula with its sign and numbers: ``+ 0.31*x*y``, ``G*(1 + 0.2*q)`` or ``G*(q/2.5)^0.66``."""
    if formula.way == "power":
        (signal,) = formula.signals
        return f"{parameter}*({signal.name}/{signal.size:.3g})^{_number(coefficient)}"
    product, size = _readable(formula, f"{constant:.3g}"), f"{abs(coefficient):.3g}"
    sign = "-" if coefficient < 0.0 else "+"
    text = f"{sign} {size}{product.removeprefix('1') if product.startswith('1/') else f'*{product}'}"
    return f"{parameter}*(1 {text})" if formula.way == "share" else text


def _number(value: float) -> str:
    return f"{value:.3g}" if value >= 0.0 else f"({value:.3g})"


def _readable(formula: Formula, constant: str) -> str:
    names = {signal.name: signal.name for signal in formula.signals}
    text = formula.text(names, constant, lambda s: f"{s.size:.3g}").removeprefix(" * ")
    text = f"1{text}" if text.startswith(" / ") else text
    return text.replace(" * ", "*").replace(" ^ ", "^").replace(" / ", "/")
