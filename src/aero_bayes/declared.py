"""What a Modelica package declares of its rigs beside their equations: ``package.toml`` next to its ``package.mo``.

Any package may carry one. It holds for the systems that it lists and for models that extend one of them; an FMU built
from such a model takes it along, see :data:`MEMBER`. All values are in SI units.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import field
from functools import lru_cache
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from aero_bayes.errors import InputError

DECLARATION_FILE = "package.toml"
#: Where an FMU keeps the declaration of the package that its model is from.
DECLARATION_MEMBER = "resources/aero_bayes.toml"
Interpolation = Literal["auto", "hold", "linear"]
Positive = Annotated[float, Field(gt=0)]
Above = Annotated[float, Field(gt=1)]
_STRICT = ConfigDict(extra="forbid")


@dataclass(frozen=True, config=_STRICT)
class ColumnSpec:
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
class DeclaredRecording:
    """What a recording of the rig has, and how it is to be understood.

    Parameters
    ----------
    inputs, outputs : mapping of str to ColumnSpec
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

    inputs: Mapping[str, ColumnSpec] = field(default_factory=dict)
    outputs: Mapping[str, ColumnSpec] = field(default_factory=dict)
    rates: tuple[float, float] = (0.0, math.inf)
    zero_at_rest: tuple[str, ...] = ()
    resting: tuple[str, ...] | None = None
    max_input_delay: float = 0.0
    interpolation: Interpolation = "auto"


@dataclass(frozen=True, config=_STRICT)
class DeclaredLimits:
    """What an experiment may ask of the rig: the largest input, and absolute values by output."""

    input: Positive | None = None
    travel: Mapping[str, Positive] = field(default_factory=dict)


@dataclass(frozen=True, config=_STRICT)
class DeclaredParameter:
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
class DeclaredEffect:
    """An effect by the name that it goes by.

    Parameters
    ----------
    law : str
        The law and its port, as ``law@port``.
    starts : mapping of str to tuple of float
        Values of its parameters worth starting a search from.
    inverse_shares : mapping of str to tuple of float
        In their place: shares of the largest input at whose inverse to start. (A limit acts only below that input.)
    """

    law: str
    starts: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    inverse_shares: Mapping[str, tuple[float, ...]] = field(default_factory=dict)


@dataclass(frozen=True, config=_STRICT)
class PackageDeclaration:
    """All that a package declares; an empty one for a model of which nothing is known.

    Parameters
    ----------
    package : str
        Its name; empty in an FMU.
    systems : tuple of str
        Models that it holds for.
    parameters : mapping of str to Searched
    fixed : mapping of str to str
        Parameters that are not searched, with the reason.
    ports : mapping of str to str
        Names of replaceable models, by the model's name in snake case.
    effects : mapping of str to Effect
        By their names. Where there are any, only they and learned curves are tried.
    """

    package: str = ""
    systems: tuple[str, ...] = ()
    recording: DeclaredRecording = DeclaredRecording()
    limits: DeclaredLimits = DeclaredLimits()
    parameters: Mapping[str, DeclaredParameter] = field(default_factory=dict)
    fixed: Mapping[str, str] = field(default_factory=dict)
    ports: Mapping[str, str] = field(default_factory=dict)
    effects: Mapping[str, DeclaredEffect] = field(default_factory=dict)

    def port_of(self, effect: str) -> str:
        """Name of the port at which an effect acts."""
        at = self.effects[effect].law.partition("@")[2]
        return self.ports.get(at, at)


def parse_declaration(text: str, where: str, package: str = "") -> PackageDeclaration:
    """Read a declaration.

    Raises
    ------
    InputError
        Where it is no TOML, or holds a key or value that does not exist; names ``where`` it stands and the key.
    """
    try:
        return _read(text, package)
    except ValidationError as error:
        problem = error.errors()[0]
        key = ".".join(map(str, problem["loc"]))
        raise InputError(f"{where}: key '{key}': {problem['msg']}") from None
    except (tomllib.TOMLDecodeError, AttributeError, TypeError) as error:
        raise InputError(f"{where}: not a valid declaration: {error}") from None


@lru_cache(maxsize=16)
def _read(text: str, package: str) -> PackageDeclaration:
    document: dict[str, Any] = tomllib.loads(text)
    for columns in (document.get("recording", {}).get(role, {}) for role in ("inputs", "outputs")):
        for name in columns:
            columns[name]["name"] = name
    return TypeAdapter(PackageDeclaration).validate_python({**document, "package": package})
