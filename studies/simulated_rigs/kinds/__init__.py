"""The kinds of rigs of the many-rig trial, by name.

States, inputs and outputs are named as in the Modelica model that the program is given. Laws that equal a change of the
free parameters (a second damper beside a damper, a gain where every parameter is free) are left out.
"""

from simulated_rigs.kinds.aero import AERO
from simulated_rigs.kinds.electrical import CIRCUIT, MOTOR
from simulated_rigs.kinds.kind import Drive, RigKind
from simulated_rigs.kinds.mechanical import CARRIAGES, CART, OSCILLATOR, PENDULUM, SHAFT
from simulated_rigs.kinds.storage import HEAT, RESERVOIRS, TANKS

KINDS: dict[str, RigKind] = {
    kind.name: kind
    for kind in (PENDULUM, CART, SHAFT, MOTOR, CIRCUIT, TANKS, HEAT, RESERVOIRS, OSCILLATOR, CARRIAGES, AERO)
}

__all__ = ["KINDS", "Drive", "RigKind"]
