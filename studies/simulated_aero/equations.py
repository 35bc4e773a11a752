"""The equations of one rig, assembled from its parameters and effects.

Written by hand from the physics, apart from the Modelica package. For the driven motor (the second one of ``one_dof``
is its mirror image: speed, current and thrust of opposite sign on the opposite arm, so it is not integrated)::

    L_a di/dt         = V - R_a i - c_m w                      (+ electrical effects)
    (J_r + J_s) dw/dt = c_m i - k_d w |w|                      (+ rotor effects)
    J_p d2theta/dt2   = n D_t F - D_p dtheta/dt - K_sp theta   (+ body effects),   F = k_t w |w|   (+ thrust effects)

with n motors. Friction and brush drop are exact sign laws: the variable may stick at zero.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from simulated_aero.truth import Truth

#: (t, i, w, theta, q, z) -> addition; q is dtheta/dt, z the extra states, z[0] the rotor's angle.
StateFunction = Callable[[float, float, float, float, float, Sequence[float]], float]
#: (F, t, i, w, theta, q, z) -> F
ThrustFunction = Callable[[float, float, float, float, float, float, Sequence[float]], float]


@dataclass(frozen=True)
class ExtraState:
    """z' = rate z + source(F, t, i, w, theta, q, z), starting at ``start``; F is the thrust before any lag."""

    rate: float
    source: ThrustFunction
    start: float = 0.0


@dataclass
class RigEquations:
    """Equations of a rig to which effects add their terms.

    ``volts`` that depend on the current come with ``slopes``, (i, z) -> -d(volts)/di in ohm, which the exact part of
    the integration takes over. ``supply`` are factors of the applied voltage over time; ``lag`` and ``speed_state`` are
    indices of extra states that stand in for the thrust and for the speed that the tachometer shows.
    """

    truth: Truth
    resistance: float
    damping: float
    viscous: float = 0.0
    amplifier: list[Callable[[float], float]] = field(default_factory=list)
    volts: list[StateFunction] = field(default_factory=list)
    rotor: list[StateFunction] = field(default_factory=list)
    thrust: list[ThrustFunction] = field(default_factory=list)
    body: list[StateFunction] = field(default_factory=list)
    brush: list[StateFunction] = field(default_factory=list)
    rotor_friction: list[StateFunction] = field(default_factory=list)
    pivot_friction: list[StateFunction] = field(default_factory=list)
    extra: list[ExtraState] = field(default_factory=list)
    supply: list[Callable[[float], float]] = field(default_factory=list)
    slopes: list[Callable[[float, Sequence[float]], float]] = field(default_factory=list)
    lag: int | None = None
    speed_state: int | None = None
    current_offset: float = 0.0
    pitch_offset: float = 0.0
    pitch_delay: float = 0.0
    max_step: float = 2.5e-3

    @classmethod
    def of(cls, truth: Truth) -> RigEquations:
        """Assemble a rig without effects."""
        equations = cls(truth, truth.parameters.R_a, truth.parameters.D_p)
        equations.add_state(ExtraState(0.0, lambda F, t, i, w, th, q, z: w))
        return equations

    @property
    def motors(self) -> int:
        """How many thrusters pitch the body."""
        return 2 if self.truth.system == "one_dof" else 1

    def add_state(self, state: ExtraState) -> int:
        """Add an extra state and return its index in z."""
        self.extra.append(state)
        return len(self.extra) - 1

    def applied(self, command: float) -> float:
        """Return the voltage that the amplifier puts out for a commanded one."""
        for law in self.amplifier:
            command = law(command)
        return command
