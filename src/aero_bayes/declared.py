"""What a Modelica package declares of its rigs beside their equations: ``package.toml`` next to its ``package.mo``.

Any package may carry one. It holds for the systems that it lists and for models that extend one of them; an FMU built
from such a model takes it along, see :data:`MEMBER`. All values are in SI units.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import field
from functools import lru_cache
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from aero_bayes.errors import InputError

FILE = "package.toml"
#: Where an FMU keeps the declaration of the package that its model is from.
MEMBER = "resources/aero_bayes.toml"
Interpolation = Literal["auto", "hold", "linear"]
Positive = Annotated[float, Field(gt=0)]
Above = Annotated[float, Field(gt=1)]
_STRICT = ConfigDict(extra="forbid")


@dataclass(frozen=True, config=_STRICT)
class Quantity:
    """One column: its SI unit and the sizes it can have.

    ``largest`` bounds its absolute value. ``per_input`` bounds the ratio of its largest absolute value to that of the
    first input (looked at only when that input reaches 1 in its unit). ``hints`` names the mistakes that a value beyond
    the bounds suggests.
    """

    name: str = ""
    unit: str = ""
    largest: float = math.inf
    per_input: tuple[float, float] = (0.0, math.inf)
    hints: str = ""


@dataclass(frozen=True, config=_STRICT)
class Recorded:
    """What a recording of the rig has, and how it is to be understood.

    Parameters
    ----------
    inputs, outputs : mapping of str to Quantity
    rates : (float, float)
        Believable sample rates in Hz.
    zero_at_rest : tuple of str
        Outputs that read nothing where the rig rests; the first that was recorded tells whether it was driven before.
    resting : tuple of str, optional
        Outputs whose state may start anywhere, at rest; all that are states where left out.
    max_input_delay : float
        How late an input may act, in s; zero for none.
    interpolation : {"auto", "hold", "linear"}
        What inputs do between samples.
    """

    inputs: Mapping[str, Quantity] = field(default_factory=dict)
    outputs: Mapping[str, Quantity] = field(default_factory=dict)
    rates: tuple[float, float] = (0.0, math.inf)
    zero_at_rest: tuple[str, ...] = ()
    resting: tuple[str, ...] | None = None
    max_input_delay: float = 0.0
    interpolation: Interpolation = "auto"


@dataclass(frozen=True, config=_STRICT)
class Allowed:
    """What an experiment may ask of the rig: the largest input, and absolute values by output."""

    input: Positive | None = None
    travel: Mapping[str, Positive] = field(default_factory=dict)


@dataclass(frozen=True, config=_STRICT)
class Searched:
    """A parameter that is searched: a log-normal prior about ``median``, by default the model's own value.

    Its spread is ``relative_sd`` of the median, or a ``factor``. Bounds are ``reach`` times beyond start and median.
    ``auto`` is one that is freed only if the data show it.
    """

    median: Positive | None = None
    relative_sd: Positive | None = None
    factor: Above = 2.0
    reach: Above = 10.0
    auto: bool = False


@dataclass(frozen=True, config=_STRICT)
class State:
    """A signal that curves may be over: an output or its ``rate``.

    ``even`` makes its range symmetric; ``typical`` is its size where the output was not recorded.
    """

    output: str
    rate: bool = False
    even: bool = False
    typical: float = 1.0


@dataclass(frozen=True, config=_STRICT)
class Port:
    """Where physics can be added: the ``unit`` of a signal there, and the class of the ``probe`` that adds one.

    ``slot`` is what is filled at it; ``seen_by`` the output without which nothing of it shows; ``size``, a product of
    parameters, inputs and sizes of states, what the model puts through it.
    """

    unit: str = ""
    slot: str = ""
    probe: str = ""
    seen_by: str = ""
    size: tuple[str, ...] = ()


@dataclass(frozen=True, config=_STRICT)
class Slot:
    """A replaceable model of the systems.

    ``component`` is what it is the class of, ``within`` the components (by the name that a system gives them) that have
    one each. Of ``partial``, its base class, all that fill it are handed the variables ``hands``; several are connected
    at the connectors ``shared``, in ``series`` from one connector to another, or pass a ``signal`` on.
    """

    component: str
    partial: str
    within: str = ""
    hands: tuple[str, ...] = ()
    series: tuple[str, str] | None = None
    signal: tuple[str, str] | None = None
    shared: tuple[str, ...] = ()
    seen_by: str = ""


@dataclass(frozen=True, config=_STRICT)
class Curve:
    """The class of a learned curve at a port over a state, which it knows itself or is handed as ``x``.

    Its values are a loss in the port's unit, or a ``share`` of what passes.
    """

    port: str
    over: str
    model: str
    x: str = ""
    share: bool = False


@dataclass(frozen=True, config=_STRICT)
class EffectParameter:
    """A new top-level parameter.

    Parameters
    ----------
    name, unit, description : str
        As declared in the extended model, in SI units.
    minimum, maximum : float
        Bounds of a search. Where the effect vanishes at zero, zero is within them.
    scale : float
        Typical magnitude.
    starts : tuple of float
        Values worth starting a search from.
    inverse_shares : tuple of float
        In their place: shares of the largest input at whose inverse to start. (A limit acts only below that input.)
    default : float
        Value in the extended model: zero where the parameter switches the effect.
    component_name : str
        Its name in the component, where that differs.
    """

    name: str
    unit: str
    description: str
    maximum: float
    scale: float
    starts: tuple[float, ...]
    minimum: float = 0.0
    inverse_shares: tuple[float, ...] = ()
    default: float = 0.0
    component_name: str = ""

    @property
    def signed(self) -> bool:
        """Whether negative values have a meaning."""
        return self.minimum < 0.0


@dataclass(frozen=True, config=_STRICT)
class Effect:
    """Physics that a system may lack.

    ``slot`` is the replaceable model that it fills, by default the port's. ``parameters[0]`` switches the effect: at
    zero nothing is left. ``widths`` names the component's smoothing constants with their values; ``rank`` orders
    effects in one slot. An effect that ``refines`` another is a finer law of the same physics, with more parameters,
    and stands in its place.
    """

    id: str
    port: str
    model: str
    parameters: tuple[EffectParameter, ...]
    summary: str
    slot: str = ""
    source: str = ""
    widths: Mapping[str, float] = field(default_factory=dict)
    rank: int = 0
    refines: str = ""

    @property
    def magnitude(self) -> EffectParameter:
        """The parameter that switches the effect."""
        return self.parameters[0]


@dataclass(frozen=True, config=_STRICT)
class Declaration:
    """All that a package declares; an empty one for a model of which nothing is known.

    Parameters
    ----------
    package : str
        Its name; empty in an FMU.
    systems : mapping
        Models that it holds for, and in each the components that ``within`` of a slot stands for.
    parameters : mapping of str to Searched
    fixed : mapping of str to str
        Parameters that are not searched, with the reason.
    """

    package: str = ""
    systems: Mapping[str, Mapping[str, tuple[str, ...]]] = field(default_factory=dict)
    recording: Recorded = Recorded()
    limits: Allowed = Allowed()
    parameters: Mapping[str, Searched] = field(default_factory=dict)
    fixed: Mapping[str, str] = field(default_factory=dict)
    states: Mapping[str, State] = field(default_factory=dict)
    ports: Mapping[str, Port] = field(default_factory=dict)
    slots: Mapping[str, Slot] = field(default_factory=dict)
    curves: tuple[Curve, ...] = ()
    effects: tuple[Effect, ...] = ()

    @property
    def catalogue(self) -> Mapping[str, Effect]:
        """Effects by id."""
        return {effect.id: effect for effect in self.effects}

    def effect(self, id_: str) -> Effect:
        """The effect of that id. Raises InputError for an unknown one."""
        if id_ not in self.catalogue:
            raise InputError(f"unknown effect {id_!r}; expected one of {', '.join(self.catalogue) or 'none'}")
        return self.catalogue[id_]

    def slot_of(self, effect: Effect) -> str:
        """The replaceable model that an effect fills."""
        return effect.slot or self.ports[effect.port].slot

    def curve(self, port: str, over: str) -> Curve:
        """The curve at a port over a state. Raises InputError where there is none."""
        for curve in self.curves:
            if (curve.port, curve.over) == (port, over):
                return curve
        options = ", ".join(f"{c.port} over {c.over}" for c in self.curves)
        raise InputError(f"no learned curve at {port} over {over}; expected {options}")

    def curve_unit(self, port: str, over: str) -> str:
        """Unit of a learned curve's values."""
        return "1" if self.curve(port, over).share else self.ports[port].unit

    def shown(self, port: str, outputs: Collection[str]) -> bool:
        """Whether recorded outputs show anything of a port."""
        return self.ports[port].seen_by in ("", *outputs)


def parse(text: str, where: str, package: str = "") -> Declaration:
    """Read a declaration.

    Raises
    ------
    InputError
        Where it is no TOML, or holds a key or value that does not exist; names ``where`` it stands and the key.
    """
    try:
        declared = _read(text, package)
        if missing := next(_missing(declared), ""):
            raise InputError(f"{where}: {missing}")
        return declared
    except ValidationError as error:
        problem = error.errors()[0]
        key = ".".join(map(str, problem["loc"]))
        raise InputError(f"{where}: key '{key}': {problem['msg']}") from None
    except (tomllib.TOMLDecodeError, AttributeError, TypeError) as error:
        raise InputError(f"{where}: not a valid declaration: {error}") from None


@lru_cache(maxsize=16)
def _read(text: str, package: str) -> Declaration:
    document: dict[str, Any] = tomllib.loads(text)
    for columns in (document.get("recording", {}).get(role, {}) for role in ("inputs", "outputs")):
        for name in columns:
            columns[name]["name"] = name
    return TypeAdapter(Declaration).validate_python({**document, "package": package})


def _missing(declared: Declaration) -> Iterator[str]:
    """What the declaration refers to and does not have."""
    for system, groups in declared.systems.items():
        for name, slot in declared.slots.items():
            if slot.within and slot.within not in groups:
                yield f"systems.{system}: no components {slot.within!r}, which slots.{name} is within"
    wanted = [(f"ports.{name}", "slots", port.slot) for name, port in declared.ports.items() if port.slot or port.probe]
    for curve in declared.curves:
        place = f"the curve at {curve.port} over {curve.over}"
        wanted += [(place, "ports", curve.port), (place, "states", curve.over)]
        wanted += [(place, "slots", declared.ports[curve.port].slot)] if curve.port in declared.ports else []
    for effect in declared.effects:
        wanted.append((f"the effect {effect.id}", "ports", effect.port))
        if effect.port in declared.ports:
            wanted.append((f"the effect {effect.id}", "slots", declared.slot_of(effect)))
        if not effect.parameters:
            yield f"the effect {effect.id}: expected a parameter that switches it"
        if effect.refines and effect.refines not in declared.catalogue:
            yield f"the effect {effect.id}: refines an effect {effect.refines!r} that is not there"
    for place, table, name in wanted:
        if name not in getattr(declared, table):
            yield f"{place}: there is no {table}.{name}"
