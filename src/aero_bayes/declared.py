"""What a Modelica package declares of its rigs besides equations, in ``package.toml`` next to its ``package.mo``.

Any package may have one. It applies to the systems that it lists, and to models that extend one of them. An FMU of such
a model contains it, see :data:`DECLARATION_MEMBER`. All values are in SI units.
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

from aero_bayes.arguments import Positive
from aero_bayes.errors import InputError

DECLARATION_FILE = "package.toml"
#: Where an FMU keeps the declaration of the package that its model is from.
DECLARATION_MEMBER = "resources/aero_bayes.toml"
Interpolation = Literal["auto", "hold", "linear"]
Above = Annotated[float, Field(gt=1)]
_STRICT = ConfigDict(extra="forbid")


@dataclass(frozen=True, config=_STRICT)
class ColumnSpec:
    """One column of a recording: its SI unit and its plausible values.

    ``largest`` bounds its absolute value. ``per_input`` bounds the ratio of its largest absolute value to that of the
    first input, if that input reaches 1 in its unit. ``hints`` are likely mistakes behind a value beyond the bounds.
    ``words`` name the only values that an enumeration or a switch has; another ``whole`` one has whole numbers only."""

    name: str = ""
    unit: str = ""
    largest: float = math.inf
    per_input: tuple[float, float] = (0.0, math.inf)
    hints: str = ""
    words: Mapping[str, float] = field(default_factory=dict)
    whole: bool = False


@dataclass(frozen=True, config=_STRICT)
class DeclaredRecording:
    """The columns of a recording of the rig, and how they are interpreted."""

    inputs: Mapping[str, ColumnSpec] = field(default_factory=dict)
    outputs: Mapping[str, ColumnSpec] = field(default_factory=dict)
    rates: tuple[float, float] = (0.0, math.inf)
    zero_at_rest: tuple[str, ...] = ()
    resting: tuple[str, ...] | None = None
    max_input_delay: float = 0.0
    interpolation: Interpolation = "auto"


@dataclass(frozen=True, config=_STRICT)
class DeclaredLimits:
    """Limits of experiments on the rig: the largest input, and the largest absolute value by output."""

    input: Positive | None = None
    travel: Mapping[str, Positive] = field(default_factory=dict)


@dataclass(frozen=True, config=_STRICT)
class DeclaredParameter:
    """A fitted parameter with a log-normal prior. Its ``median`` is by default the value in the model.

    The standard deviation is ``relative_sd`` of the median, or given by a ``factor``. Bounds are a factor ``reach``
    beyond the starting value and the median. With ``auto``, the parameter is fitted only if the data identify it."""

    median: Positive | None = None
    relative_sd: Positive | None = None
    factor: Above = 2.0
    reach: Above = 10.0
    auto: bool = False


@dataclass(frozen=True, config=_STRICT)
class DeclaredEffect:
    """An effect under a declared name: a law at ports, ``coulomb_friction@rotor``.

    The law acts at once at all ports that have the name, or are joined by ``+``; those that a model does not have are
    left out. ``starts`` and ``inverse_shares`` (of the largest input) are values from which a search starts, ``sizes``
    typical sizes of the port in place of those that the recordings show."""

    law: str
    sizes: Mapping[str, Positive] = field(default_factory=dict)
    starts: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    inverse_shares: Mapping[str, tuple[float, ...]] = field(default_factory=dict)


@dataclass(frozen=True, config=_STRICT)
class PackageDeclaration:
    """All that a package declares; empty for a model without a declaration.

    ``ports`` has names of ports by their ids. If there are ``effects``, no other laws are tried."""

    package: str = ""
    systems: tuple[str, ...] = ()
    recording: DeclaredRecording = DeclaredRecording()
    limits: DeclaredLimits = DeclaredLimits()
    parameters: Mapping[str, DeclaredParameter] = field(default_factory=dict)
    fixed: Mapping[str, str] = field(default_factory=dict)
    ports: Mapping[str, str] = field(default_factory=dict)
    effects: Mapping[str, DeclaredEffect] = field(default_factory=dict)


def parse_declaration(text: str, where: str, package: str = "") -> PackageDeclaration:
    """Read a declaration."""
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
