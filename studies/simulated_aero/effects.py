"""The 19 effects of the catalogue as the bench has them: exact and, where the physics is, not smooth.

Each kind knows its port, its parameters and how it changes a rig. All vanish when the first parameter is zero.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import copysign, cos

from aero_bayes.errors import InputError
from simulated_aero.equations import ExtraState, RigEquations
from simulated_aero.truth import EffectTruth

Install = Callable[[RigEquations, Mapping[str, float]], None]
Range = tuple[float, float]


@dataclass(frozen=True)
class EffectKind:
    """One kind of effect.

    Parameters
    ----------
    id, port : str
    ranges : mapping of str to (float, float)
        Per parameter (SI) the smallest and largest value that trials draw, uniform in the logarithm. The first is the
        magnitude.
    install : callable
        Puts the effect with given parameters into a rig.
    signed : bool
        Whether the magnitude is drawn with either sign.
    """

    id: str
    port: str
    ranges: Mapping[str, Range]
    install: Install
    signed: bool = False

    @property
    def magnitude(self) -> str:
        """Name of the parameter that is zero where there is no effect."""
        return next(iter(self.ranges))

    def truth(self, **parameters: float) -> EffectTruth:
        """Make an effect of this kind. Raises InputError for missing or unknown parameters."""
        if set(parameters) != set(self.ranges):
            raise InputError(f"bench: {self.id} takes {', '.join(self.ranges)}, not {', '.join(parameters) or 'none'}")
        return EffectTruth(self.id, self.port, parameters)


def _supply_resistance(equations: RigEquations, p: Mapping[str, float]) -> None:
    equations.resistance += p["R_s"]


def _brush_drop(equations: RigEquations, p: Mapping[str, float]) -> None:
    drop = p["V_b"]
    equations.brush.append(lambda t, i, w, th, q, z: drop)


def _winding_heating(equations: RigEquations, p: Mapping[str, float]) -> None:
    gain, rate = p["r_h"], 1.0 / p["T_h"]
    index = equations.add_state(ExtraState(-rate, lambda F, t, i, w, th, q, z: rate * gain * i * i))
    equations.volts.append(lambda t, i, w, th, q, z: -z[index] * i)
    equations.slopes.append(lambda i, z: z[index])


def _amplifier_deadzone(equations: RigEquations, p: Mapping[str, float]) -> None:
    width = p["V_dz"]
    equations.amplifier.append(lambda v: copysign(max(abs(v) - width, 0.0), v))


def _amplifier_saturation(equations: RigEquations, p: Mapping[str, float]) -> None:
    if p["s_sat"] > 0.0:
        limit = 1.0 / p["s_sat"]
        equations.amplifier.append(lambda v: min(max(v, -limit), limit))


def _rotor_coulomb_friction(equations: RigEquations, p: Mapping[str, float]) -> None:
    level = p["tau_r"]
    equations.rotor_friction.append(lambda t, i, w, th, q, z: level)


def _rotor_viscous_friction(equations: RigEquations, p: Mapping[str, float]) -> None:
    equations.viscous += p["d_r"]


def _thrust_inflow_loss(equations: RigEquations, p: Mapping[str, float]) -> None:
    loss = p["k_v"] * equations.truth.parameters.D_t
    equations.thrust.append(lambda F, t, i, w, th, q, z: F - loss * abs(w) * q)


def _thrust_lag(equations: RigEquations, p: Mapping[str, float]) -> None:
    if p["T_f"] <= 0.0:
        return
    rate = 1.0 / p["T_f"]
    equations.lag = equations.add_state(ExtraState(-rate, lambda F, t, i, w, th, q, z: rate * F))


def _thrust_asymmetry(equations: RigEquations, p: Mapping[str, float]) -> None:
    share = p["a_f"]
    equations.thrust.append(lambda F, t, i, w, th, q, z: F * (1.0 + copysign(share, F)))


def _pivot_coulomb_friction(equations: RigEquations, p: Mapping[str, float]) -> None:
    level = p["tau_c"]
    equations.pivot_friction.append(lambda t, i, w, th, q, z: level)


def _body_quadratic_drag(equations: RigEquations, p: Mapping[str, float]) -> None:
    drag = p["c_b"]
    equations.body.append(lambda t, i, w, th, q, z: -drag * q * abs(q))


def _gravity_offset(equations: RigEquations, p: Mapping[str, float]) -> None:
    torque = p["tau_g"]
    equations.body.append(lambda t, i, w, th, q, z: torque * cos(th))


def _pivot_presliding_friction(equations: RigEquations, p: Mapping[str, float]) -> None:
    """Add a spring in series with a dry slider (Dahl's model), as a bearing that yields or a cable that creeps."""
    torque = p["tau_p"]
    if torque <= 0.0:
        return
    stiffness = torque / p["theta_p"]
    index = len(equations.extra)
    equations.add_state(ExtraState(0.0, lambda F, t, i, w, th, q, z: stiffness * (q - abs(q) * z[index] / torque)))
    equations.body.append(lambda t, i, w, th, q, z: -z[index])


def _cubic_stiffness(equations: RigEquations, p: Mapping[str, float]) -> None:
    stiffness = p["k_3"]
    equations.body.append(lambda t, i, w, th, q, z: -stiffness * th**3)


def _current_offset(equations: RigEquations, p: Mapping[str, float]) -> None:
    equations.current_offset += p["b_i"]


def _speed_lag(equations: RigEquations, p: Mapping[str, float]) -> None:
    if p["T_w"] <= 0.0:
        return
    rate = 1.0 / p["T_w"]
    equations.speed_state = equations.add_state(ExtraState(-rate, lambda F, t, i, w, th, q, z: rate * w))


def _pitch_delay(equations: RigEquations, p: Mapping[str, float]) -> None:
    equations.pitch_delay += p["T_d"]


def _pitch_offset(equations: RigEquations, p: Mapping[str, float]) -> None:
    equations.pitch_offset += p["b_th"]


#: Sizes from an information distance of about 4 (with the noise of :func:`simulated_aero.sensors.white`) to plain.
KINDS: dict[str, EffectKind] = {
    kind.id: kind
    for kind in (
        EffectKind("supply_resistance", "electrical", {"R_s": (0.2, 3.0)}, _supply_resistance),
        EffectKind("brush_drop", "electrical", {"V_b": (5e-3, 0.6)}, _brush_drop),
        EffectKind("winding_heating", "electrical", {"r_h": (1.0, 60.0), "T_h": (4.0, 20.0)}, _winding_heating),
        EffectKind("amplifier_deadzone", "electrical", {"V_dz": (6e-3, 0.8)}, _amplifier_deadzone),
        EffectKind("amplifier_saturation", "electrical", {"s_sat": (1.0 / 18.0, 1.0 / 13.0)}, _amplifier_saturation),
        EffectKind("rotor_coulomb_friction", "rotor", {"tau_r": (1.2e-5, 1e-3)}, _rotor_coulomb_friction),
        EffectKind("rotor_viscous_friction", "rotor", {"d_r": (1e-7, 6e-6)}, _rotor_viscous_friction),
        EffectKind("thrust_inflow_loss", "thrust", {"k_v": (4e-6, 3e-4)}, _thrust_inflow_loss),
        EffectKind("thrust_lag", "thrust", {"T_f": (6e-4, 0.1)}, _thrust_lag),
        EffectKind("thrust_asymmetry", "thrust", {"a_f": (5e-4, 0.1)}, _thrust_asymmetry, signed=True),
        EffectKind("pivot_coulomb_friction", "body", {"tau_c": (4e-6, 1.5e-3)}, _pivot_coulomb_friction),
        EffectKind(
            "pivot_presliding_friction",
            "body",
            {"tau_p": (1e-4, 5e-3), "theta_p": (3e-3, 0.1)},
            _pivot_presliding_friction,
        ),
        EffectKind("body_quadratic_drag", "body", {"c_b": (3e-5, 2e-2)}, _body_quadratic_drag),
        EffectKind("gravity_offset", "body", {"tau_g": (5e-6, 2e-3)}, _gravity_offset, signed=True),
        EffectKind("cubic_stiffness", "body", {"k_3": (4e-5, 3e-2)}, _cubic_stiffness),
        EffectKind("current_offset", "sensor", {"b_i": (3e-4, 5e-2)}, _current_offset, signed=True),
        EffectKind("speed_lag", "sensor", {"T_w": (4e-4, 0.05)}, _speed_lag),
        EffectKind("pitch_delay", "sensor", {"T_d": (4e-4, 0.05)}, _pitch_delay),
        EffectKind("pitch_offset", "sensor", {"b_th": (1e-4, 0.03)}, _pitch_offset, signed=True),
    )
}
