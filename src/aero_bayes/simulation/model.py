"""What an FMU says of itself, read once and kept as plain typed values."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Variable:
    """A scalar Real of the model, in SI units as declared."""

    name: str
    unit: str
    description: str
    start: float | None
    minimum: float | None
    maximum: float | None
    nominal: float | None
    value_reference: int


@dataclass(frozen=True)
class Model:
    """An FMU on disk and its description.

    ``parameters`` are the Real parameters that may be set before initialisation (fixed or tunable), ``states`` the
    continuous states in the FMU's own order.
    """

    path: Path
    sha256: str
    name: str
    guid: str
    identifier: str
    parameters: tuple[Variable, ...]
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    states: tuple[Variable, ...]
    event_indicators: int
    has_directional_derivatives: bool
    needs_instance_per_process: bool

    @classmethod
    def load(cls, path: Path | str) -> Model:
        """Read and check an FMU. Raises InputError for a file that is not a usable FMI 2.0 Model-Exchange FMU."""
        raise NotImplementedError
