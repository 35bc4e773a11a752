"""The catalogue of effects: what the base models may lack, port by port.

Ids and ports are a contract; the physics of each effect is a component of ``Aero.Effects``. Bounds and scales come from
the size of the base model's own terms at nominal values, not from any data.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Port = Literal["electrical", "rotor", "thrust", "body", "sensor"]

PORTS: tuple[Port, ...] = ("electrical", "rotor", "thrust", "body", "sensor")


@dataclass(frozen=True)
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
    default : float
        Value in the extended model: zero where the parameter switches the effect.
    component_name : str
        Its name in the component, where that differs.
    """

    name: str
    unit: str
    description: str
    minimum: float
    maximum: float
    scale: float
    starts: tuple[float, ...]
    default: float = 0.0
    component_name: str = ""

    @property
    def signed(self) -> bool:
        """Whether negative values have a meaning."""
        return self.minimum < 0.0


@dataclass(frozen=True)
class Effect:
    """An effect of the catalogue.

    ``slot`` is the replaceable model that it fills. ``parameters[0]`` switches the effect: at zero nothing is left.
    ``widths`` names the component's smoothing constants with their values; ``rank`` orders effects in one slot. An
    effect that ``refines`` another is a finer law of the same physics, with more parameters, and stands in its place.
    """

    id: str
    port: Port
    slot: str
    model: str
    parameters: tuple[EffectParameter, ...]
    summary: str
    source: str = ""
    widths: Mapping[str, float] = field(default_factory=dict)
    rank: int = 0
    refines: str = ""

    @property
    def magnitude(self) -> EffectParameter:
        """The parameter that switches the effect."""
        return self.parameters[0]


def _positive(
    name: str, unit: str, description: str, maximum: float, scale: float, starts: tuple[float, ...]
) -> EffectParameter:
    return EffectParameter(name, unit, description, 0.0, maximum, scale, starts)


def _signed(name: str, unit: str, description: str, limit: float, scale: float, inner: str = "") -> EffectParameter:
    return EffectParameter(name, unit, description, -limit, limit, scale, (scale, -scale), component_name=inner)


def _shape(
    name: str, unit: str, description: str, low: float, high: float, starts: tuple[float, ...]
) -> EffectParameter:
    return EffectParameter(name, unit, description, low, high, high, starts, high)


_ENTRIES = (
    Effect(
        "supply_resistance", "electrical", "ElectricalEffect", "SupplyResistance",
        (_positive("R_s", "Ohm", "Resistance of supply and leads", 20.0, 1.0, (0.3, 2.0)),),
        "resistance of supply and leads in series with each motor", rank=3,
    ),
    Effect(
        "brush_drop", "electrical", "ElectricalEffect", "BrushDrop",
        (_positive("V_b", "V", "Voltage drop of the brush contacts", 6.0, 0.5, (0.2, 1.0)),),
        "voltage drop of the brush contacts, independent of the size of the current",
        widths={"i_smooth": 1e-5}, rank=4,
    ),
    Effect(
        "winding_heating", "electrical", "ElectricalEffect", "WindingHeating",
        (
            _positive("r_h", "Ohm/A2", "Added resistance of the warm winding", 1000.0, 20.0, (10.0, 60.0)),
            EffectParameter("T_h", "s", "Time constant of the winding's heating", 0.5, 500.0, 10.0, (4.0, 25.0), 10.0),
        ),
        "armature resistance that grows as the winding heats", rank=5,
    ),
    Effect(
        "amplifier_deadzone", "electrical", "ElectricalEffect", "AmplifierDeadzone",
        (_positive("V_dz", "V", "Half width of the amplifier's dead zone", 6.0, 0.5, (0.2, 1.0)),),
        "amplifier that does not answer small voltages", widths={"v_smooth": 0.01}, rank=1,
    ),
    Effect(
        "amplifier_saturation", "electrical", "ElectricalEffect", "AmplifierSaturation",
        (_positive("s_sat", "1/V", "Inverse of the amplifier's limit", 0.5, 0.05, (0.045, 0.055, 0.07, 0.1)),),
        "amplifier whose voltage is limited", widths={"knee": 1e-3}, rank=2,
    ),
    Effect(
        "rotor_coulomb_friction", "rotor", "RotorEffect", "RotorCoulombFriction",
        (_positive("tau_r", "N.m", "Dry friction torque of a rotor", 0.02, 1e-3, (2e-4, 1e-3)),),
        "dry friction of the rotor's bearings and brushes", widths={"w_smooth": 0.05},
    ),
    Effect(
        "rotor_viscous_friction", "rotor", "RotorEffect", "RotorViscousFriction",
        (_positive("d_r", "N.m.s/rad", "Viscous friction of a rotor", 2e-4, 2e-6, (1e-6, 6e-6)),),
        "friction torque of the rotor in proportion to its speed", rank=1,
    ),
    Effect(
        "thrust_inflow_loss", "thrust", "ThrustEffect", "ThrustInflowLoss",
        (_positive("k_v", "N.s2/(m.rad)", "Loss of thrust by speed and velocity", 5e-3, 1e-4, (3e-5, 2e-4)),),
        "thrust that falls as the propeller moves along its axis",
        source="momentum theory, e.g. Leishman, Principles of Helicopter Aerodynamics (2006), ch. 2",
    ),
    Effect(
        "thrust_lag", "thrust", "ThrustEffect", "ThrustLag",
        (_positive("T_f", "s", "Time constant of the thrust", 3.0, 0.1, (0.04, 0.2)),),
        "thrust that follows the rotor's speed late", widths={"T_min": 1e-3}, rank=1,
    ),
    Effect(
        "thrust_asymmetry", "thrust", "ThrustEffect", "ThrustAsymmetry",
        (_signed("a_f", "1", "Relative gain of thrust pitching up, loss pitching down", 0.9, 0.1),),
        "thrust that differs between pitching up and pitching down", widths={"f_smooth": 1e-4}, rank=2,
    ),
    Effect(
        "pivot_coulomb_friction", "body", "BodyEffect", "PivotCoulombFriction",
        (_positive("tau_c", "N.m", "Dry friction torque at the pivot", 0.05, 1e-3, (3e-4, 1.5e-3)),),
        "dry friction at the pivot", widths={"w_smooth": 2e-5},
    ),
    Effect(
        "body_quadratic_drag", "body", "BodyEffect", "BodyQuadraticDrag",
        (_positive("c_b", "N.m.s2/rad2", "Air drag of the body", 0.5, 5e-3, (2e-3, 1e-2)),),
        "air drag of the body", rank=1,
    ),
    Effect(
        "gravity_offset", "body", "BodyEffect", "GravityOffset",
        (_signed("tau_g", "N.m", "Torque of a centre of mass beside the pivot, at zero pitch", 0.05, 1e-3),),
        "centre of mass beside the pivot", rank=2,
    ),
    Effect(
        "cubic_stiffness", "body", "BodyEffect", "CubicStiffness",
        (_signed("k_3", "N.m/rad3", "Cubic part of the body's stiffness", 0.5, 5e-3),),
        "stiffness that changes with the pitch angle", rank=3,
    ),
    Effect(
        "current_offset", "sensor", "CurrentSensor", "SensorOffset",
        (_signed("b_i", "A", "Offset of the current reading", 1.0, 0.01, "b"),),
        "current reading that is off by a constant",
    ),
    Effect(
        "speed_lag", "sensor", "SpeedSensor", "SensorLag",
        (_positive("T_w", "s", "Time constant of the speed reading", 1.0, 0.03, (0.01, 0.06)),),
        "speed reading that follows late", widths={"T_min": 1e-3},
    ),
    Effect(
        "pitch_delay", "sensor", "PitchSensor", "SensorDelay",
        (_positive("T_d", "s", "Delay of the pitch reading", 0.5, 0.03, (0.01, 0.06)),),
        "pitch reading that comes late",
        source="Padé approximation of second order", widths={"T_min": 2e-3},
    ),
    Effect(
        "pitch_offset", "sensor", "PitchSensor", "SensorOffset",
        (_signed("b_th", "rad", "Offset of the pitch reading", 0.5, 0.01, "b"),),
        "pitch reading that is off by a constant", rank=1,
    ),
    Effect(
        "pivot_presliding_friction", "body", "BodyEffect", "PivotPreslidingFriction",
        (
            _positive("tau_p", "N.m", "Dry friction torque at the pivot once it slides", 0.05, 1e-3, (3e-4, 1.5e-3)),
            _shape("theta_p", "rad", "Angle by which the pivot yields before it slides", 1e-4, 0.3, (1e-3, 5e-3, 0.05)),
            _shape("w_p", "rad/s", "Rate of the vibration under which the pivot creeps", 1e-5, 0.05, (1e-4, 5e-3)),
        ),
        "dry friction at the pivot that yields before it slides and creeps under vibration",
        source="P. R. Dahl, A solid friction model, TOR-0158(3107-18)-1, The Aerospace Corporation (1968)",
        rank=4, refines="pivot_coulomb_friction",
    ),
)  # fmt: skip

CATALOGUE: Mapping[str, Effect] = {e.id: e for e in _ENTRIES}
