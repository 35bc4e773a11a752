"""The kinds of rigs of the many-rig trial, by name.

States, inputs and outputs are named as in the Modelica model that the program is given. Laws that equal a change of the
free parameters (a second damper beside a damper, a gain where every parameter is free) are left out.
"""

from __future__ import annotations

from simulated_rigs.rig import Balance, Coupling, Drive, RigKind

#: Laws of dry friction, which any sliding or turning part may have.
FRICTION = "coulomb_friction friction_by_direction stribeck_friction presliding_friction"
#: What an actuator of flow, heat or voltage may have; a drive that reverses may have a dead zone too.
ONE_WAY = "saturation rate_limit square_law lag delay hysteresis"
ACTUATOR = f"dead_zone {ONE_WAY}"
#: Temperature of the surroundings in K.
AMBIENT = 293.15


PENDULUM = RigKind(
    "pendulum",
    {"J": 0.05, "D": 0.06, "G": 1.2},
    {"tau": Drive(0.0, 0.6, 1.6, "N.m")},
    {
        "phi": Balance("rate", "omega", 0.3, 0.05),
        "omega": Balance("motion", "tau - D*omega - G*sin(phi)", 1.5, inertia="J", position="phi"),
    },
    {"angle": ("phi", "rad")},
    0.01,
    6001,
    {
        "in:tau": f"{ACTUATOR} offset",
        "omega": f"{FRICTION} quadratic_drag offset linear_stiffness cubic_stiffness end_stop",
        "out:angle": "gain offset lag delay",
    },
    linear=False,
)


CART = RigKind(
    "cart",
    {"mass.m": 1.5, "spring.k": 60.0, "damper.d": 2.0},
    {"F": Drive(0.0, 10.0, 1.0, "N")},
    {
        "spring.s": Balance("rate", "mass.v", 0.1, 0.01),
        "mass.v": Balance(
            "motion", "F - spring.k*spring.s - damper.d*mass.v", 0.35, inertia="mass.m", position="spring.s"
        ),
    },
    {"position": ("spring.s", "m")},
    0.01,
    6001,
    {
        "in:F": f"{ACTUATOR} gain offset",
        "mass.v": f"{FRICTION} quadratic_drag offset cubic_stiffness end_stop",
        "out:position": "gain offset lag delay",
    },
    known=("mass.m",),
)


TORQUE = "shaft.c*shaft.phi + shaft.d*(motor.w - load.w)"
SHAFT = RigKind(
    "shaft",
    {"motor.J": 0.02, "load.J": 0.05, "shaft.c": 4.0, "shaft.d": 0.02, "bearing.d": 0.04},
    {"tau": Drive(0.0, 1.5, 1.0, "N.m")},
    {
        "motor.w": Balance("motion", f"tau - ({TORQUE})", 10.0, 0.2, inertia="motor.J"),
        "load.w": Balance("motion", f"{TORQUE} - bearing.d*load.w", 10.0, 0.2, inertia="load.J"),
        "shaft.phi": Balance("rate", "motor.w - load.w", 0.2),
    },
    {"w_motor": ("motor.w", "rad/s"), "w_load": ("load.w", "rad/s")},
    0.01,
    6001,
    {
        "in:tau": f"{ACTUATOR} offset",
        "motor.w": f"{FRICTION} viscous_friction quadratic_drag offset",
        "load.w": f"{FRICTION} quadratic_drag offset",
        "shaft.phi": "backlash",
        "out:w_motor": "gain offset lag delay",
        "out:w_load": "gain offset lag delay",
    },
    couplings={"shaft.phi": Coupling("motor.w", "load.w", "shaft.c", "shaft.d")},
)


OSCILLATOR = RigKind(
    "oscillator",
    {"m": 1.0e-3, "d": 0.015, "k": 1.5},
    {"u": Drive(0.0, 0.6, 0.2)},
    {
        "x": Balance("rate", "v", 0.2, 0.01),
        "v": Balance("motion", "u - d*v - k*x", 5.0, inertia="m", position="x"),
    },
    {"y": ("x", "")},
    2e-3,
    6001,
    {
        "in:u": f"{ACTUATOR} offset",
        "v": f"{FRICTION} quadratic_drag offset cubic_stiffness end_stop",
        "out:y": "offset lag delay",
    },
)


PULL = "k2*(s2 - s1) + d2*(v2 - v1)"
CARRIAGES = RigKind(
    "carriages",
    {"m1": 2.0, "m2": 1.0, "k1": 80.0, "k2": 50.0, "d1": 3.0, "d2": 0.8},
    {"f1": Drive(0.0, 15.0, 1.0, "N"), "f2": Drive(0.0, 6.0, 1.7, "N")},
    {
        "s1": Balance("rate", "v1", 0.14, 0.01),
        "v1": Balance("motion", f"f1 - k1*s1 - d1*v1 + ({PULL})", 0.5, inertia="m1", position="s1"),
        "s2": Balance("rate", "v2", 0.18, 0.01),
        "v2": Balance("motion", f"f2 - ({PULL})", 0.7, inertia="m2", position="s2"),
    },
    {"x1": ("s1", "m"), "x2": ("s2", "m")},
    0.01,
    6001,
    {
        "in:f1": f"{ACTUATOR} gain offset",
        "in:f2": f"{ACTUATOR} gain offset",
        "v1": f"{FRICTION} quadratic_drag offset cubic_stiffness end_stop",
        "v2": f"{FRICTION} viscous_friction quadratic_drag offset linear_stiffness cubic_stiffness",
        "out:x1": "gain offset lag delay",
        "out:x2": "gain offset lag delay",
    },
)


MOTOR = RigKind(
    "motor",
    {"R": 2.0, "L": 0.02, "k_m": 0.08, "J": 2.0e-4, "d": 2.0e-4},
    {"V": Drive(0.0, 12.0, 0.1, "V")},
    {
        "i": Balance("electrical", "V - R*i - k_m*w", 2.5, inertia="L"),
        "w": Balance("motion", "k_m*i - d*w", 50.0, 2.0, inertia="J"),
    },
    {"current": ("i", "A"), "speed": ("w", "rad/s")},
    1e-3,
    6001,
    {
        "in:V": f"{ACTUATOR} offset",
        "i": "contact_drop heating",
        "w": f"{FRICTION} quadratic_drag offset",
        "out:current": "offset lag delay",
        "out:speed": "offset lag delay",
    },
)


CIRCUIT = RigKind(
    "circuit",
    {"coil.L": 0.1, "capacitor.C": 1.0e-3, "load.R": 20.0},
    {"u": Drive(0.0, 10.0, 0.15, "V")},
    {
        "coil.i": Balance("electrical", "u - capacitor.v", 0.4, inertia="coil.L"),
        "capacitor.v": Balance("storage", "coil.i - 1.0/load.R*capacitor.v", 6.0, 0.3, inertia="capacitor.C"),
    },
    {"v_out": ("capacitor.v", "V"), "i_in": ("coil.i", "A")},
    1e-3,
    6001,
    {
        "in:u": f"{ACTUATOR} gain offset",
        "coil.i": "series_resistance contact_drop heating",
        "capacitor.v": "square_loss offset",
        "out:v_out": "gain offset lag delay",
        "out:i_in": "offset lag delay",
    },
)


TANKS = RigKind(
    "tanks",
    {"k1": 0.05, "k2": 0.05, "k3": 0.03, "k4": 0.05},
    {"u": Drive(3.0, 1.8, 90.0)},
    {
        "h1": Balance("storage", "k3*u - k1*sqrt(max(h1, 0.0))", 1.3, 0.3, rest="(k3*3.0/k1)**2", neighbour="h2"),
        "h2": Balance(
            "storage",
            "k2*sqrt(max(h1, 0.0)) - k4*sqrt(max(h2, 0.0))",
            1.1,
            0.3,
            rest="(k2*(k3*3.0/k1)/k4)**2",
            neighbour="h1",
        ),
    },
    {"y": ("h2", "")},
    4.0,
    1501,
    {
        "in:u": f"{ONE_WAY} offset",
        "h1": "linear_loss square_loss overflow offset exchange",
        "h2": "linear_loss square_loss overflow offset",
        "out:y": "offset lag delay",
    },
    linear=False,
)


HEAT = RigKind(
    "heat",
    {"heater.C": 300.0, "plate.C": 900.0, "wall.G": 1.5, "skin.G": 0.8},
    {"P": Drive(60.0, 55.0, 400.0, "W")},
    {
        "heater.T": Balance(
            "storage",
            "P - wall.G*(heater.T - plate.T)",
            20.0,
            3.0,
            inertia="heater.C",
            rest=f"{AMBIENT} + 60.0/skin.G + 60.0/wall.G",
            reference=AMBIENT,
            neighbour="plate.T",
        ),
        "plate.T": Balance(
            "storage",
            f"wall.G*(heater.T - plate.T) - skin.G*(plate.T - {AMBIENT})",
            10.0,
            3.0,
            inertia="plate.C",
            rest=f"{AMBIENT} + 60.0/skin.G",
            reference=AMBIENT,
            neighbour="heater.T",
        ),
    },
    {"T_heater": ("heater.T", "K"), "T_plate": ("plate.T", "K")},
    5.0,
    2401,
    {
        "in:P": f"{ONE_WAY} offset",
        "heater.T": "linear_loss square_loss offset radiation",
        "plate.T": "square_loss offset radiation",
        "out:T_heater": "offset lag delay",
        "out:T_plate": "offset lag delay",
    },
)


RESERVOIRS = RigKind(
    "reservoirs",
    {"first.A": 0.02, "second.A": 0.04, "pipe.c": 4.0e-4, "outlet.c": 3.0e-4},
    {"q": Drive(1.5e-4, 1.2e-4, 150.0, "m3/s")},
    {
        "first.h": Balance(
            "storage",
            "q - pipe.c*(first.h - second.h)",
            0.2,
            0.03,
            inertia="first.A",
            rest="1.5e-4/outlet.c + 1.5e-4/pipe.c",
            neighbour="second.h",
        ),
        "second.h": Balance(
            "storage",
            "pipe.c*(first.h - second.h) - outlet.c*second.h",
            0.1,
            0.03,
            inertia="second.A",
            rest="1.5e-4/outlet.c",
            neighbour="first.h",
        ),
    },
    {"level_1": ("first.h", "m"), "level_2": ("second.h", "m")},
    1.0,
    4001,
    {
        "in:q": f"{ONE_WAY} offset",
        "first.h": "linear_loss root_loss square_loss overflow offset",
        "second.h": "root_loss square_loss overflow offset",
        "out:level_1": "gain offset lag delay",
        "out:level_2": "gain offset lag delay",
    },
)


#: Parameters are named as in the paper and those of the AERO's documents. ``k_t`` is what the documented thrust gain of
#: 0.0011 N m/V asks of two propellers with a quadratic law at 24 V, ``k_d`` what 0.08 A at 376 rad/s asks of the motor.
#: The second motor is the mirror image of the first, of opposite sign on the opposite arm; ``motors`` is their number.
AERO = RigKind(
    "aero",
    {
        "R_a": 8.4,
        "L_a": 1.16e-3,
        "c_m": 0.042,
        "J_r": 4.0e-6,
        "J_s": 4.0e-6,
        "k_d": 2.4e-8,
        "k_t": 2.9e-7,
        "J_p": 0.0219,
        "D_p": 0.0071,
        "K_sp": 0.0375,
        "D_t": 0.158,
    },
    {"V_m": Drive(0.0, 20.0, 1.0, "V")},
    {
        "i": Balance("electrical", "V_m - R_a*i - c_m*w", 0.5, inertia="L_a"),
        "w": Balance("motion", "c_m*i - k_d*(w*abs(w))", 200.0, inertia="J_r + J_s"),
        "theta": Balance("rate", "q", 0.2),
        "q": Balance("motion", "motors*D_t*k_t*(w*abs(w)) - D_p*q - K_sp*theta", 0.2, inertia="J_p", position="theta"),
    },
    {"i_m": ("i", "A"), "omega_m": ("w", "rad/s"), "pitch": ("theta", "rad")},
    0.01,
    6001,
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
    constants={"motors": 2.0},
    linear=False,
    method="LSODA",
    hold=50,
)

KINDS: dict[str, RigKind] = {
    kind.name: kind
    for kind in (PENDULUM, CART, SHAFT, MOTOR, CIRCUIT, TANKS, HEAT, RESERVOIRS, OSCILLATOR, CARRIAGES, AERO)
}
