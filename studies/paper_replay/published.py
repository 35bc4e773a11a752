"""Table 1 of the paper (Podlaski et al.), as data, and how its numbers enter our models."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from aero_bayes.estimate.levenberg_marquardt import Stage

#: Columns of Table 1, and the only parameters that the paper searches.
TABLE_PARAMETERS = ("R_a", "L_a", "J_r", "J_s", "k_d", "k_t")
#: The paper fits the electrical parameters on current, the mechanical ones on speed, the aerodynamic ones on pitch.
PAPER_STAGES = (
    Stage(("R_a", "L_a"), ("i_m",)),
    Stage(("J_r", "J_s"), ("omega_m",)),
    Stage(("k_d", "k_t"), ("theta",)),
)

#: What Quanser documents for the voltage-to-pitch model (torque about the pitch axis for each volt), N.m/V.
TRANSFER_GAIN = 0.0011


@dataclass(frozen=True)
class Published:
    """One row of Table 1: its own numbers, and Eq. 6 of data that is not public."""

    label: str
    parameters: Mapping[str, float]
    fitness: float

    @property
    def model_values(self) -> dict[str, float]:
        """Values as ``Aero.Systems.OneDofLinear`` takes them, whose drag opposes the rotation by itself."""
        return {name: -value if name == "k_d" else value for name, value in self.parameters.items()}


def _row(label: str, fitness: float, *values: float) -> Published:
    return Published(label, MappingProxyType(dict(zip(TABLE_PARAMETERS, values, strict=True))), fitness)


UNOPTIMISED = _row("Unoptimised", 29.3903, 8.4, 0.00116, 4e-6, 4e-6, -1e-5, 0.00045)
PSO = _row("PSO Model 1", 498.7173, 0.187, 0.0487, 84.2, 0.0, -0.587, 0.000689)
PSO_DATASHEET = _row("PSO + data sheet", 28.2230, 8.4, 0.00116, 84.2, 0.0, -0.587, 0.000689)
FMINCON = _row("fmincon", 0.2280, 8.4, 0.00116, 3.45e-11, 0.000174, -1e-5, 0.0004)
TRANSFER = Published("Transfer function", MappingProxyType({"R_a": 8.4, "k_d": -1e-5, "k_t": 0.00045}), 42.7060)

TABLE_1 = (UNOPTIMISED, PSO, PSO_DATASHEET, FMINCON, TRANSFER)

#: Corners of the box that is searched. The paper does not print its own; this one reaches, on every axis, from zero to
#: the next power of ten above everything that Table 1 holds.
BOX: Mapping[str, tuple[float, float]] = MappingProxyType(
    {name: (0.0, top) for name, top in zip(TABLE_PARAMETERS, (10.0, 0.1, 100.0, 100.0, 1.0, 1e-3), strict=True)}
)
