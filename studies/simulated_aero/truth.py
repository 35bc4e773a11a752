"""What a simulated AERO truly is: parameters, set-up, and the effects that a model may lack."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, Literal

from aero_bayes.errors import InputError

System = Literal["one_dof", "half_quad"]


@dataclass(frozen=True)
class Parameters:
    """Physical parameters in SI units, named as in the paper.

    The defaults are those of the AERO's documents; ``k_t`` is what the documented thrust gain of 0.0011 N m/V asks of
    two propellers with a quadratic law at 24 V, ``k_d`` what 0.08 A at 376 rad/s asks of the motor.
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


@dataclass(frozen=True)
class EffectTruth:
    """An effect of a simulated rig: which, where it acts, and how large it is.

    Parameters
    ----------
    id : str
        A name of the catalogue (:data:`simulated_aero.effects.KINDS`), or one of the caller's own kinds.
    port : str
        ``electrical``, ``rotor``, ``thrust``, ``body`` or ``sensor``; ``moment`` for a disturbance tied to a time.
    parameters : mapping of str to float
        In SI units.
    """

    id: str
    port: str
    parameters: Mapping[str, float]


@dataclass(frozen=True)
class Truth:
    """A whole simulated rig.

    Parameters
    ----------
    system : {"one_dof", "half_quad"}
        Two motors driven against each other, or one.
    parameters : Parameters
    effects : tuple of EffectTruth
    input_delay : float
        Time in s from the sample at which a voltage is commanded to the moment the amplifier applies it.
    """

    system: System = "one_dof"
    parameters: Parameters = Parameters()
    effects: tuple[EffectTruth, ...] = ()
    input_delay: float = 0.0
    note: str = field(default="simulated", compare=False)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for a file beside the recordings; they are never in the recordings."""
        return asdict(self)
