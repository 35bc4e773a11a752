"""Effects that no catalogue lists: what a real rig may do and no one thought of."""

from __future__ import annotations

from collections.abc import Mapping
from math import copysign, exp, pi, sin, tanh

from simulated_aero import EffectKind
from simulated_aero.equations import RigEquations


def _battery_sag(equations: RigEquations, p: Mapping[str, float]) -> None:
    """Let the supply run down: its voltage falls by a share, with a time constant."""
    share, tau = p["share"], p["tau"]
    equations.supply.append(lambda t: 1.0 - share * (1.0 - exp(-max(t, 0.0) / tau)))


def _contact_film(equations: RigEquations, p: Mapping[str, float]) -> None:
    """Add a brush contact whose resistance falls with current: v = V_f i / (|i| + i_f)."""
    drop, scale = p["V_f"], p["i_f"]
    equations.volts.append(lambda t, i, w, th, q, z: -drop * i / (abs(i) + scale))
    equations.slopes.append(lambda i, z: drop * scale / (abs(i) + scale) ** 2)


def _cogging(equations: RigEquations, p: Mapping[str, float]) -> None:
    """Add torque over the rotor's angle with a fixed number of periods a turn."""
    torque, periods = p["tau_g"], p["periods"]
    equations.rotor.append(lambda t, i, w, th, q, z: -torque * sin(periods * z[0]))
    equations.max_step = min(equations.max_step, 5e-4)


def _eddy_drag(equations: RigEquations, p: Mapping[str, float]) -> None:
    """Add a brake that saturates with speed."""
    torque, scale = p["tau_e"], p["w_e"]
    equations.rotor.append(lambda t, i, w, th, q, z: -torque * tanh(w / scale))


def _propeller_stall(equations: RigEquations, p: Mapping[str, float]) -> None:
    """Bend thrust away from the square of speed: k_t w |w| (1 - s |w|)."""
    loss = p["s"]
    equations.thrust.append(lambda F, t, i, w, th, q, z: F * (1.0 - loss * abs(w)))


def _ground_effect(equations: RigEquations, p: Mapping[str, float]) -> None:
    """Let thrust grow as the body comes near the table, on one side only."""
    gain, scale = p["gain"], p["angle"]
    equations.thrust.append(lambda F, t, i, w, th, q, z: F * (1.0 + gain * exp(min(-th / scale, 2.0))))


def _thrust_drift(equations: RigEquations, p: Mapping[str, float]) -> None:
    """Let thrust fall over the recording as the blades warm and flatten."""
    share, tau = p["share"], p["tau"]
    equations.thrust.append(lambda F, t, i, w, th, q, z: F * (1.0 - share * (1.0 - exp(-max(t, 0.0) / tau))))


def _friction_patch(equations: RigEquations, p: Mapping[str, float]) -> None:
    """Add dry friction at the pivot in a band of angles only (a worn bearing)."""
    torque, centre, width = p["tau_p"], p["centre"], p["width"]
    equations.pivot_friction.append(lambda t, i, w, th, q, z: torque * exp(-(((th - centre) / width) ** 2)))


def _spring_backlash(equations: RigEquations, p: Mapping[str, float]) -> None:
    """Take away the spring within a band of angles: the missing part of the linear one."""
    gap, stiffness = p["gap"], equations.truth.parameters.K_sp
    equations.body.append(lambda t, i, w, th, q, z: stiffness * min(max(th, -gap), gap))


def _spring_asymmetry(equations: RigEquations, p: Mapping[str, float]) -> None:
    """Let the spring soften with the square of the angle on one side and stiffen on the other."""
    stiffness = p["k_2"]
    equations.body.append(lambda t, i, w, th, q, z: -stiffness * th * abs(th) * (0.5 + copysign(0.5, th)))


def _gust(equations: RigEquations, p: Mapping[str, float]) -> None:
    """Blow a breath of wind on the body at a moment."""
    torque, moment, width = p["tau"], p["time"], p["width"]
    equations.body.append(lambda t, i, w, th, q, z: torque * exp(-(((t - moment) / width) ** 2)))


def _touch(equations: RigEquations, p: Mapping[str, float]) -> None:
    """Push a hand against the body for a short while."""
    torque, moment, width = p["tau"], p["time"], p["width"]

    def push(t: float) -> float:
        return torque * sin(pi * (t - moment) / width) ** 2 if moment < t < moment + width else 0.0

    equations.body.append(lambda t, i, w, th, q, z: push(t))


KINDS: dict[str, EffectKind] = {
    kind.id: kind
    for kind in (
        EffectKind("battery_sag", "electrical", {"share": (0.02, 0.2), "tau": (10.0, 60.0)}, _battery_sag),
        EffectKind("contact_film", "electrical", {"V_f": (0.2, 2.0), "i_f": (0.05, 0.3)}, _contact_film),
        EffectKind("cogging", "rotor", {"tau_g": (2e-3, 2e-2), "periods": (4.0, 4.0)}, _cogging),
        EffectKind("eddy_drag", "rotor", {"tau_e": (3e-4, 3e-3), "w_e": (40.0, 150.0)}, _eddy_drag),
        EffectKind("propeller_stall", "thrust", {"s": (1e-4, 1e-3)}, _propeller_stall),
        EffectKind("ground_effect", "thrust", {"gain": (0.02, 0.3), "angle": (0.1, 0.4)}, _ground_effect),
        EffectKind("thrust_drift", "thrust", {"share": (0.02, 0.3), "tau": (10.0, 60.0)}, _thrust_drift),
        EffectKind(
            "friction_patch",
            "body",
            {"tau_p": (5e-4, 5e-3), "centre": (0.1, 0.3), "width": (0.05, 0.15)},
            _friction_patch,
        ),
        EffectKind("spring_backlash", "body", {"gap": (0.01, 0.1)}, _spring_backlash),
        EffectKind("spring_asymmetry", "body", {"k_2": (3e-3, 5e-2)}, _spring_asymmetry, signed=True),
        EffectKind(
            "gust", "moment", {"tau": (2e-3, 2e-2), "time": (15.0, 45.0), "width": (0.3, 2.0)}, _gust, signed=True
        ),
        EffectKind(
            "touch", "moment", {"tau": (2e-3, 2e-2), "time": (15.0, 45.0), "width": (0.5, 3.0)}, _touch, signed=True
        ),
    )
}
