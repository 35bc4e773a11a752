"""The AERO: a winding, a rotor with its propeller, and the body that one or two of them pitch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace

from aero_bayes.errors import InputError
from simulated_rigs.assembly import Balance
from simulated_rigs.kinds.kind import ACTUATOR, FRICTION, Drive, RigKind, at_zero
from simulated_rigs.plant import Plant, Values


def _aero(p: Mapping[str, float]) -> Plant:
    """Write the driven motor; the second one is its mirror image, of opposite sign on the opposite arm.

    ``motors`` says how many there are; two where it is not given.
    """
    r, c, k_d, damping, stiffness = p["R_a"], p["c_m"], p["k_d"], p["D_p"], p["K_sp"]
    gain = p.get("motors", 2.0) * p["D_t"] * p["k_t"]

    def efforts(x: Values, u: Values) -> list[float]:
        i, w, theta, q = x[0], x[1], x[2], x[3]
        square = w * abs(w)
        return [u[0] - r * i - c * w, c * i - k_d * square, q, gain * square - damping * q - stiffness * theta]

    return Plant((p["L_a"], p["J_r"] + p["J_s"], 1.0, p["J_p"]), efforts, (0, 1, 2))


@dataclass(frozen=True)
class Parameters:
    """Physical parameters in SI units, named as in the paper; the defaults are those of the AERO's documents.

    ``k_t`` is what the documented thrust gain of 0.0011 N m/V asks of two propellers with a quadratic law at 24 V,
    ``k_d`` what 0.08 A at 376 rad/s asks of the motor.
    """

    R_a: float = 8.4
    L_a: float = 1.16e-3
    c_m: float = 0.042
    J_r: float = 4.0e-6
    J_s: float = 4.0e-6
    k_d: float = 2.4e-8
    k_t: float = 2.9e-7
    J_p: float = 0.0219
    D_p: float = 0.0071
    K_sp: float = 0.0375
    D_t: float = 0.158

    def scaled(self, factors: Mapping[str, float]) -> Parameters:
        """Multiply some parameters by a factor; ``J`` scales both rotor inertias."""
        known = {item.name for item in fields(self)}
        changed = {}
        for name, factor in factors.items():
            for target in ("J_r", "J_s") if name == "J" else (name,):
                if target not in known:
                    raise InputError(f"bench: no parameter {name}")
                changed[target] = getattr(self, target) * factor
        return replace(self, **changed)


#: The half-quadrotor bench of the public step recording: other propellers and a stiffer body.
HALF_QUAD = Parameters(k_t=8.2e-7, K_sp=0.09, D_p=0.0056, R_a=9.6)


AERO = RigKind(
    "aero",
    asdict(Parameters()),
    {"V_m": Drive(0.0, 20.0, 1.0)},
    {
        "i": Balance("electrical"),
        "w": Balance("motion"),
        "theta": Balance("rate"),
        "q": Balance("motion", position="theta"),
    },
    ("i_m", "omega_m", "pitch"),
    {"V_m": "V", "i_m": "A", "omega_m": "rad/s", "pitch": "rad"},
    0.01,
    6001,
    _aero,
    at_zero(4),
    (0.5, 200.0, 0.2, 0.2),
    (0.0, 0.0, 0.0, 0.0),
    {
        "in:V_m": f"{ACTUATOR} offset",
        "i": "contact_drop heating",
        "w": f"{FRICTION} viscous_friction offset",
        "q": f"{FRICTION} quadratic_drag offset cubic_stiffness end_stop",
        "out:i_m": "offset lag delay",
        "out:omega_m": "offset lag delay",
        "out:pitch": "offset lag delay",
    },
    known=("L_a", "J_s", "J_p", "D_t"),
    linear=False,
    method="LSODA",
    hold=50,
)
