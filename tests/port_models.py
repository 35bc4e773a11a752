"""Models with ports of every kind, and the ports that are found there."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from small_rigs import RIGS

CAR = """model Car "A quarter of a car"
  parameter Real m_b(unit = "kg", min = 0) = 250;
  parameter Real m_w(unit = "kg", min = 0) = 40;
  parameter Real k_s(unit = "N/m", min = 0) = 20000;
  parameter Real c_s(unit = "N.s/m", min = 0) = 1000;
  parameter Real k_t(unit = "N/m", min = 0) = 160000;
  input Real road(unit = "m");
  output Real body(unit = "m", start = 0, fixed = true);
  output Real wheel(unit = "m", start = 0, fixed = true);
protected
  Real v_b(unit = "m/s", start = 0, fixed = true);
  Real v_w(unit = "m/s", start = 0, fixed = true);
  Real f(unit = "N") "Force of the suspension";
equation
  f = k_s*(body - wheel) + c_s*(v_b - v_w);
  der(body) = v_b;
  der(wheel) = v_w;
  m_b*der(v_b) = -f;
  m_w*der(v_w) = f - k_t*(wheel - road);
end Car;
"""
SHAFT = """model Shaft "Three inertias, the last one on its own"
  parameter Real J(unit = "kg.m2") = 1;
  input Real tau(unit = "N.m");
  output Real w_1(unit = "rad/s", start = 0, fixed = true);
  Real w_2(unit = "rad/s", start = 0, fixed = true);
  Real w_3(unit = "rad/s", start = 0, fixed = true);
  Real phi(unit = "rad", start = 0, fixed = true);
equation
  der(phi) = w_2 - w_1;
  J*der(w_1) = tau + 30*phi;
  J*der(w_2) = -30*phi - 0.1*w_2;
  J*der(w_3) = tau - 0.2*w_3;
end Shaft;
"""
DRIVE = """model Drive "Two inertias, a shaft between them that is a component of its own, and a brake"
  connector Flange
    Real phi(unit = "rad");
    flow Real tau(unit = "N.m");
  end Flange;
  model Rotor
    parameter Real J(unit = "kg.m2", min = 0) = 0.01;
    Flange fl;
    Real w(unit = "rad/s", start = 0, fixed = true);
    input Real tau(unit = "N.m");
  equation
    w = der(fl.phi);
    J*der(w) = tau + fl.tau;
  end Rotor;
  model Shaft
    parameter Real c(unit = "N.m/rad", min = 0) = 40;
    Flange a;
    Flange b;
  equation
    a.tau = c*(a.phi - b.phi) + 0.1*(der(a.phi) - der(b.phi));
    a.tau + b.tau = 0;
  end Shaft;
  input Real u(unit = "N.m");
  output Real n(unit = "rad/s");
  Rotor motor(fl(phi(start = 0, fixed = true)), tau = u);
  Rotor load(J = 0.03, fl(phi(start = 0, fixed = true)), tau = -0.02*load.w);
  Rotor far(J = 0.05, fl(phi(start = 0, fixed = true)), tau = -0.02*far.w);
  Shaft shaft;
  Shaft second(c = 20);
equation
  connect(motor.fl, shaft.a);
  connect(shaft.b, load.fl);
  connect(load.fl, second.a);
  connect(second.b, far.fl);
  n = load.w;
end Drive;
"""
OVEN = """model Oven "An oven in a hall whose temperature is recorded"
  parameter Real C(unit = "J/K", min = 0) = 350;
  parameter Real G(unit = "W/K", min = 0) = 0.8;
  input Real P(unit = "W");
  input Real T_hall(unit = "degC");
  input Real T_set(unit = "K");
  output Real T(unit = "degC", start = 20, fixed = true);
  Real T_wall(unit = "degC", start = 20, fixed = true);
equation
  C*der(T) = P - 2*(T - T_wall);
  4*C*der(T_wall) = 2*(T - T_wall) - G*(T_wall - T_hall);
end Oven;
"""
PLAIN = """model Plain "A vessel with no units, stirred into a stream"
  parameter Real k = 0.5;
  input Real u;
  input Real w;
  output Real y(start = 0, fixed = true);
equation
  der(y) = k*(u - y) + w;
end Plain;
"""
ARM = """model Arm "An arm that a controller drives to a goal by a voltage"
  parameter Real k(unit = "V/rad") = 4;
  parameter Real k_m(unit = "N.m/V") = 0.5;
  parameter Real J(unit = "kg.m2") = 0.1;
  parameter Real d(unit = "N.m.s/rad") = 0.3;
  parameter Real c(unit = "N.m/rad") = 0.2;
  input Real goal(unit = "rad");
  output Real phi(unit = "rad", start = 0, fixed = true);
  Real w(unit = "rad/s", start = 0, fixed = true);
  Real u(unit = "V");
equation
  u = k*(goal - phi);
  der(phi) = w;
  J*der(w) = k_m*u - d*w;
end Arm;
"""
SERVO = """model Servo "An axis that follows a set point"
  parameter Real k = 4;
  input Real phi_set(unit = "rad");
  output Real phi(unit = "rad", start = 0, fixed = true);
  Real w(unit = "rad/s", start = 0, fixed = true);
  Real e(unit = "rad");
equation
  e = phi_set - phi;
  der(phi) = w;
  0.1*der(w) = k*e - 0.3*w;
end Servo;
"""
AXIS = """model Axis "A position loop"
  parameter Real J(unit = "kg", min = 0) = 0.6;
  parameter Real b(unit = "N.s/m", min = 0) = 1;
  parameter Real K_p(unit = "N/m") = 40;
  parameter Real K_i(unit = "N/(m.s)") = 10;
  parameter Real K_d(unit = "N.s/m") = 4;
  input Real r(unit = "m") "Set point";
  output Real y(unit = "m", start = 0, fixed = true);
  output Real watched(unit = "N") "What acts on the axis";
protected
  Real v(unit = "m/s", start = 0, fixed = true);
  Real z(unit = "m.s", start = 0, fixed = true) "Integral of the error";
  Real e(unit = "m") = r - y;
  Real u(unit = "N") "What the controller asks for";
  Real twice(unit = "m");
equation
  twice = 2*r;
  der(z) = e;
  u = K_p*e + K_i*z - K_d*v;
  der(y) = v;
  J*der(v) = u - b*v;
  watched = u - 0*twice;
end Axis;
"""
BLOCKS = """package Blocks
  connector In = input Real;
  connector Out = output Real;
  block PI
    In r;
    In y;
    Out u;
    parameter Real K_p = 5;
    parameter Real K_i(unit = "1/s") = 2;
    Real z(start = 0, fixed = true);
  equation
    der(z) = r - y;
    u = K_p*(r - y) + K_i*z;
  end PI;
  block Plant
    In u;
    Out y(start = 0, fixed = true);
    parameter Real K = 1.2;
    parameter Real T(unit = "s") = 3;
  equation
    T*der(y) = K*u - y;
  end Plant;
  model Rig "A plant with its controller"
    In r;
    Out y;
    PI pi;
    Plant plant;
  equation
    connect(r, pi.r);
    connect(plant.y, pi.y);
    connect(pi.u, plant.u) annotation (Line(points = {{0, 0}, {10, 0}}));
    connect(plant.y, y);
  end Rig;
end Blocks;
"""
INTEGRATORS = """package Chain
  connector In = input Real;
  connector Out = output Real;
  block Integrator
    In u;
    Out y(start = 0, fixed = true);
    parameter Real k = 1;
  equation
    der(y) = k*u;
  end Integrator;
  model Rig "A swing in blocks"
    In u;
    Out y;
    Integrator rate;
    Integrator level(k = GAIN);
  equation
    rate.u = 2.0*u - 0.8*rate.y - 1.8*level.y;
    connect(rate.y, level.u);
    connect(level.y, y);
  end Rig;
end Chain;
"""
CASCADE = """model Cascade "A filter, an amplifier and a second filter"
  parameter Real T_1(unit = "s", min = 0) = 0.12;
  parameter Real T_2(unit = "s", min = 0) = 0.25;
  parameter Real K = 1;
  input Real u(unit = "V");
  output Real y(unit = "V", start = 0, fixed = true);
  Real x(unit = "V", start = 0, fixed = true);
  Real g(unit = "V") "What the first filter hands on";
equation
  T_1*der(x) + x = u;
  g = K*x;
  T_2*der(y) + y = g;
end Cascade;
"""
FILTERS = """model Filters "Two filters in a row, by their matrices"
  parameter Real a(unit = "1/s", min = 0) = 9;
  parameter Real A[2, 2](each unit = "1/s") = {{-a, 0}, {5, -5}};
  parameter Real B[2](each unit = "1/s") = {a, 0};
  parameter Real C[2] = {0.3, 0.7};
  input Real u(unit = "V");
  output Real y(unit = "V");
  Real x[2](each unit = "V", each start = 0, each fixed = true);
  Real z[2](each unit = "V", each start = 0, each fixed = true);
  Real w(unit = "V") "Between the filters";
equation
  der(x) = A*x + B*u;
  w = C*x;
  der(z) = A*z + B*w;
  y = z[2];
end Filters;
"""
DAMPER = """model Damper
  parameter Real c(unit = "N.s/m") = 200;
  parameter Real k(unit = "N/m") = 300;
  parameter Real F_0(unit = "N") = 50;
  input Real x(unit = "m");
  input Real v(unit = "m/s");
  output Real F(unit = "N");
equation
  {equation}
end Damper;
"""
COUPLED = """model Coupled
  parameter Real c(unit = "N.s/m") = 20;
  parameter Real k(unit = "N/m") = 300;
  input Real a(unit = "N");
  output Real F(unit = "N");
  Real x_1(unit = "m", start = 0, fixed = true);
  Real x_2(unit = "m", start = 0, fixed = true);
  Real v_1(unit = "m/s", start = 0, fixed = true);
  Real v_2(unit = "m/s", start = 0, fixed = true);
equation
  der(x_1) = v_1;
  der(x_2) = v_2;
  2 * der(v_1) = a - F;
  3 * der(v_2) = F;
  F = c * (v_1 - v_2) + k * (x_1 - x_2);
end Coupled;
"""
CELL = """model Cell
  parameter Real E_0(unit = "V") = 3.6;
  parameter Real k(unit = "V") = 0.5;
  parameter Real R(unit = "Ohm") = 0.03;
  parameter Real Q(unit = "C") = 9000;
  input Real i(unit = "A");
  output Real v(unit = "V");
  Real z(start = 0.8, fixed = true) "State of charge";
equation
  der(z) = {sign}i / Q;
  v = E_0 + k * z {sign} R * i;
end Cell;
"""
FILTER = """within ;
model Filter "Source, resistor, capacitor, and a probe at their node"
  model Capacitor
    extends Shaft.TwoPin(v(start = 0, fixed = true));
    parameter Real C(unit = "F") = 1e-3;
  equation
    C * der(v) = i;
  end Capacitor;
  input Real u(unit = "V");
  output Real y(unit = "V") = leak.p.v;
  Shaft.Source source(u = u);
  Shaft.Resistor resistor(R = 100);
  Shaft.Resistor leak(R = 1e9);
  Capacitor capacitor;
  Shaft.Ground ground;
equation
  connect(source.p, resistor.p);
  connect(resistor.n, capacitor.p) annotation (Line(points = {{0,0},{1,1}}));
  connect(leak.p, capacitor.p);
  connect(capacitor.n, ground.p);
  connect(source.n, ground.p);
  connect(leak.n, ground.p);
end Filter;
"""
GROUNDED = """within ;
model Grounded "A chain whose capacitors have one pin"
  model Capacitor
    Shaft.Pin p;
    Real v(unit = "V", start = 0, fixed = true) = p.v;
    parameter Real C(unit = "F") = 1e-3;
  equation
    C * der(v) = p.i;
  end Capacitor;
  input Real u(unit = "V");
  output Real y(unit = "V") = one.v;
  Shaft.Source source(u = u);
  Shaft.Resistor resistor(R = 100);
  Capacitor one;
  Shaft.Ground ground;
equation
  connect(source.p, resistor.p);
  connect(resistor.n, one.p);
  connect(source.n, ground.p);
end Grounded;
"""
JOINTS = """model Arm "Two joints; {how}"
  parameter Real a = 0.3, b = 0.05, c = 0.02, d[2](each unit = "N.m.s/rad") = {{0.1, 0.2}};
  input Real tau(unit = "N.m");
  output Real y(unit = "rad") = q[1];
  Real q[2](each unit = "rad", each start = 0, each fixed = true);
  Real v[2](each unit = "rad/s", each start = 0, each fixed = true);
  Real M[2, 2](each unit = "kg.m2") = [a, b * cos(q[2]); b * cos(q[2]), c];
  Real h[2](each unit = "N.m") = {{b * sin(q[1]) * v[2]^2, c * sin(q[2])}};
equation
  der(q) = v;
  {balance}
end Arm;
"""
#: Stands for the library's function, which calls LAPACK.
SOLVE = """package Modelica
  package Math
    package Matrices
      function solve
        input Real A[:, size(A, 1)];
        input Real b[size(A, 1)];
        output Real x[size(b, 1)];
        external "FORTRAN 77" dgesv(A, b, x);
      end solve;
    end Matrices;
  end Math;
end Modelica;
"""
CHAIN = """model Chain
  parameter Integer n = {n};
  parameter Real C[n](each unit = "J/K") = linspace(2, 4, n), G(unit = "W/K") = 0.5;
  input Real P(unit = "W");
  output Real y(unit = "K") = T[n];
  Real T[n](each unit = "K", each start = 290, each fixed = true);
  Real Q[n + 1](each unit = "W");
equation
  Q[1] = P;
  for i in 1:n - 1 loop
    Q[i + 1] = G * (T[i] - T[i + 1]);
  end for;
  Q[n + 1] = 0;
  {balance}
end Chain;
"""
VESSELS = """model Vessel
  parameter Real A(unit = "m2") = 2;
  input Real q(unit = "m3/s");
  Real h(unit = "m", start = 1, fixed = true);
equation
  A * der(h) = q - 0.1 * h;
end Vessel;

model Plant
  input Real u(unit = "m3/s");
  output Real y(unit = "m") = tank[2].h;
  Vessel tank[2];
equation
  tank[1].q = u;
  tank[2].q = 0.1 * tank[1].h;
end Plant;
"""
CRANE = """model Crane
  parameter Real M = 2;
  parameter Real m = 0.3;
  parameter Real l = 0.4;
  input Real F(unit = "N");
  output Real y(unit = "m") = x;
  output Real a(unit = "rad") = phi;
  Real x(unit = "m", start = 0, fixed = true);
  Real v(unit = "m/s", start = 0, fixed = true);
  Real phi(unit = "rad", start = 0, fixed = true);
  Real w(unit = "rad/s", start = 0, fixed = true);
  Real z(unit = "m", start = 0, fixed = true) "Nut of a screw";
equation
  der(x) = v;
  der(phi) = w;
  m * l * cos(phi) * der(v) + m * l ^ 2 * der(w) = -m * 9.81 * l * sin(phi);
  (M + m) * der(v) + m * l * cos(phi) * der(w) = F + m * l * w ^ 2 * sin(phi);
  der(z) = 0.01 * w;
end Crane;
"""
LIBRARY = """package Lib
  package Units
    type Place = Real(unit = "m");
    type Speed = Real(unit = "m/s");
  end Units;
  package Parts
    import U = Lib.Units;
    connector Flange
      U.Place s;
      flow Real f(unit = "N");
    end Flange;
    model Mass "has a length"
      parameter Real m(unit = "kg") = 2, L(unit = "m") = 0.3;
      Flange a, b;
      U.Place s(start = 0, fixed = true);
      U.Speed v(start = 0, fixed = true);
      Real acc(unit = "m/s2");
    equation
      a.s = s - L / 2;
      b.s = s + L / 2;
      v = der(s);
      acc = der(v);
      m * acc = a.f + b.f;
    end Mass;
    model Strut
      parameter Real c(unit = "N/m") = 50, d(unit = "N.s/m") = 3;
      Flange a, b;
      U.Place s_rel;
      U.Speed v_rel;
      Real acc_rel(unit = "m/s2");
      Real f(unit = "N");
    equation
      s_rel = b.s - a.s;
      v_rel = der(s_rel);
      acc_rel = der(v_rel);
      f = c * s_rel + d * v_rel;
      b.f = f;
      a.f = -f;
    end Strut;
    model Shaker "moves its flange as it is told, a filter in between"
      input Real target(unit = "m");
      Flange a;
      U.Place s(start = 0, fixed = true);
      U.Speed v(start = 0, fixed = true);
    equation
      a.s = s;
      v = der(s);
      der(v) = ((target - s) * 300 - v) * 300;
    end Shaker;
    model Accelerometer
      Flange a;
      U.Speed v;
      Real acc(unit = "m/s2");
    equation
      v = der(a.s);
      acc = der(v);
      a.f = 0;
    end Accelerometer;
    model Wall
      Flange a;
    equation
      a.s = 0;
    end Wall;
  end Parts;
end Lib;
"""
LIBRARY_CAR = """model Car
  import Lib.Parts.*;
  input Real road(unit = "m");
  output Real y(unit = "m/s2") = sensor.acc;
  Mass body, wheel(m = 0.5);
  Strut strut(c = 20), tyre(c = 300), twin(c = 1), brake;
  Shaker shaker(target = road);
  Accelerometer sensor;
  Wall wall;
equation
  connect(shaker.a, tyre.a);
  connect(tyre.b, wheel.a);
  connect(wheel.b, strut.a);
  connect(wheel.b, twin.a);
  connect(strut.b, body.a);
  connect(twin.b, body.a);
  connect(body.b, brake.a);
  connect(brake.b, wall.a);
  connect(sensor.a, body.a);
end Car;
"""
RIM_OF_MATRICES = """model Rig
  parameter Real A[2, 2] = {{-1, 0.4}, {0.2, -3}};
  input Real u[2](each unit = "V");
  output Real y[2](each unit = "m");
  Real x[2](each start = 0, each fixed = true);
equation
  der(x) = A * x + u;
  y = {x[1] + 0.1 * u[2], x[2]};
end Rig;
"""
RIM_OF_A_LOOP = """model Rig
  input Real u[2](each unit = "V");
  Real x[2](each start = 0, each fixed = true);
  output Real y[2](each unit = "m") = {x[1] + 0.1 * u[2], x[2]} "Readings";
protected
  Real pushed[2];
equation
  for i in 1:2 loop
    pushed[i] = u[i];
  end for;
  der(x[1]) = -x[1] + 0.4 * x[2] + pushed[1];
  der(x[2]) = 0.2 * x[1] - 3 * x[2] + pushed[2];
end Rig;
"""
RIM_OF_CONNECTORS = """package Rims
  connector In = input Real;
  connector Out = output Real;
  model Plant
    In u[2];
    Out y[2](each start = 0, each fixed = true);
  equation
    der(y[1]) = -y[1] + 0.4 * y[2] + u[1];
    der(y[2]) = 0.2 * y[1] - 3 * y[2] + u[2];
  end Plant;
  model Rig
    In u[2](each unit = "V");
    Out y[2](each unit = "m");
    Plant plant;
  equation
    connect(u, plant.u);
    connect(plant.y[1], y[1]);
    connect(plant.y[2], y[2]);
  end Rig;
end Rims;
"""
RIM_OF_STATES = """model Rig
  input Real u[2](each unit = "V");
  output Real y[2](each unit = "m", each start = 0, each fixed = true);
equation
  der(y) = {-y[1] + 0.4 * y[2] + u[1], 0.2 * y[1] - 3 * y[2] + u[2]};
end Rig;
"""
#: A balance of two joints, as one writes it; and what stands there with viscous friction at the second one.
JOINTS_BALANCES = {
    "on the left": ("M * der(v) + h + d .* v = {tau, 0};", "+ {0, d_v_2 * v[2]} = {tau, 0};"),
    "in the element": (
        "M * der(v) = {tau - h[1] - d[1] * v[1], -h[2] - d[2] * v[2]};", "-h[2] - d[2] * v[2] - d_v_2 * v[2]};",
    ),
    "beside a vector": ("M * der(v) = {tau, 0} - h - diagonal(d) * v;", "- {0, d_v_2 * v[2]};"),
    "negative": ("-M * der(v) = h - {tau, 0} + d .* v;", "+ d .* v + {0, d_v_2 * v[2]};"),
    "solved": (
        "der(v) = Modelica.Math.Matrices.solve(M, {tau, 0} - h - d .* v);", "h - d .* v - {0, d_v_2 * v[2]});",
    ),
}  # fmt: skip
#: A balance of one of several masses; and what stands there with a loss of the second one.
CHAIN_BALANCES = {
    "a loop": (
        3, "for i in 1:n loop\n    der(T[i]) = (Q[i] - Q[i + 1]) / C[i];\n  end for;", "if i == 2 then",
    ),
    "a shifted loop": (
        3, "for k in 2:n + 1 loop\n    C[k - 1] * der(T[k - 1]) = Q[k - 1] - Q[k];\n  end for;", "if k == 3 then",
    ),
    "a vector": (3, "der(T) = (Q[1:n] - Q[2:n + 1]) ./ C;", "{0, k * (T[2] - 0), 0}) ./ C"),
    "a long vector": (
        8, "diagonal(C) * der(T) = Q[1:n] - Q[2:n + 1];",
        "{if row_k == 2 then k * (T[2] - 0) else 0 for row_k in 1:8}",
    ),
}  # fmt: skip
DAMPERS = {
    "with speed": "F = c * v + k * x + F_0;",
    "against speed": "F = -c * v - k * x + F_0;",
    "on the right": "c * v + k * x = F;",
    "against a product": "F = F_0 - v * c;",
    "without speed": "F = k * x + F_0;",
}


@dataclass(frozen=True)
class PortModel:
    """The name of a model, its text, and texts beside it by file."""

    name: str
    text: str
    beside: tuple[tuple[str, str], ...] = ()

    def written_to(self, folder: Path) -> list[Path]:
        """Write the files of the model."""
        texts = {f"{self.name.partition('.')[0]}.mo": self.text, **dict(self.beside)}
        for name, text in texts.items():
            (folder / name).write_text(text, encoding="utf-8")
        return [folder / name for name in texts]


def of_rig(name: str) -> PortModel:
    """A model of the test rigs."""
    return PortModel(name, (RIGS / f"{name.partition('.')[0]}.mo").read_text(encoding="utf-8"))


SHAFT_LIBRARY = (("Shaft.mo", (RIGS / "Shaft.mo").read_text(encoding="utf-8")),)
MODELS: dict[str, PortModel] = {
    "cart": of_rig("Cart"),
    "pendulum": of_rig("Pendulum"),
    "tank pair": of_rig("TankPair"),
    "circuit": of_rig("Rlc"),
    "motor": of_rig("Motor"),
    "motor of components": of_rig("Shaft.Motor"),
    "bodies": of_rig("Bodies.Pair"),
    "car": PortModel("Car", CAR),
    "deflection whose rate is taken": PortModel(
        "Car",
        CAR.replace(
            "f = k_s*(body - wheel) + c_s*(v_b - v_w);", "x = body - wheel;\n  f = k_s*x + c_s*der(x);"
        ).replace("protected", 'protected\n  Real x(unit = "m");'),
    ),
    "twist that is a state": PortModel("Shaft", SHAFT),
    "shaft that is a component": PortModel("Drive", DRIVE),
    "oven": PortModel("Oven", OVEN),
    "oven with one unit of a sum": PortModel(
        "Oven", OVEN.replace('Real T_wall(unit = "degC", ', "Real T_wall(").replace('T(unit = "degC", ', "T(")
    ),
    "no units": PortModel("Plain", PLAIN),
    "two without units": PortModel(
        "Plain",
        PLAIN.replace("  input Real u;", "  Real z(start = 0, fixed = true);\n  input Real u;").replace(
            "+ w;", "+ w;\n  der(z) = w - 2*z;"
        ),
    ),
    "controller of a voltage": PortModel("Arm", ARM),
    "spring to a goal": PortModel("Arm", ARM.replace("- d*w", "- d*w - c*(phi - goal)")),
    "position loop without units": PortModel("Servo", SERVO),
    "position loop": PortModel("Axis", AXIS),
    "blocks": PortModel("Blocks.Rig", BLOCKS),
    "integrators": PortModel("Chain.Rig", INTEGRATORS.replace("GAIN", "1")),
    "integrators with a gain": PortModel("Chain.Rig", INTEGRATORS.replace("GAIN", "3")),
    "cascade": PortModel("Cascade", CASCADE),
    "loaded cascade": PortModel("Cascade", CASCADE.replace("x = u;", "x = u - 0.1*y;")),
    "filters": PortModel("Filters", FILTERS),
    "filters and a state by another name": PortModel("Filters", FILTERS.replace("w = C*x", "w = -x[2]")),
    "loaded filters": PortModel("Filters", FILTERS.replace("B*u", "B*(u - 0.1*z[2])")),
    **{f"damper {k}": PortModel("Damper", DAMPER.format(equation=e)) for k, e in DAMPERS.items()},
    "force between two masses": PortModel("Coupled", COUPLED),
    "cell": PortModel("Cell", CELL.format(sign="-")),
    "charged cell": PortModel("Cell", CELL.format(sign="+")),
    "filter of components": PortModel("Filter", FILTER, SHAFT_LIBRARY),
    "grounded capacitor": PortModel("Grounded", GROUNDED, SHAFT_LIBRARY),
    **{
        f"joints {how}": PortModel("Arm", JOINTS.format(how=how, balance=balance), (("Modelica.mo", SOLVE),))
        for how, (balance, _) in JOINTS_BALANCES.items()
    },
    **{
        f"chain in {how}": PortModel("Chain", CHAIN.format(n=n, balance=balance))
        for how, (n, balance, _) in CHAIN_BALANCES.items()
        if n == 3
    },
    "array of components": PortModel("Plant", VESSELS),
    "crane": PortModel("Crane", CRANE),
    "each place once": PortModel("Car", LIBRARY_CAR, (("Lib.mo", LIBRARY),)),
    "rim of matrices": PortModel("Rig", RIM_OF_MATRICES),
    "rim of a loop": PortModel("Rig", RIM_OF_A_LOOP),
    "rim of connectors": PortModel("Rims.Rig", RIM_OF_CONNECTORS),
    "rim of states": PortModel("Rig", RIM_OF_STATES),
}

#: Ports but for those at inputs and outputs: id, kind, attachment and unit, and what laws read there.
PORTS = """
cart
  v: motion equation N; v = v, x = x, load = F - F_v * v - K * x
pendulum
  w: motion equation N.m; v = w, x = phi, load = u - d * w - m * g * l * sin(phi)
tank pair
  h1: storage equation V/s; h = h1
  h2: storage equation V/s; h = h2
circuit
  i: electrical equation V; i = i
  v_C: storage equation A; h = v_C
motor
  i: electrical equation V; i = i
  w: motion equation N.m; v = w, load = tau - d * w
motor of components
  inductor.p: electrical series V; i = inductor.p.i
  rotor.a: motion node N.m; v = rotor.w, x = rotor.phi
  load.a: motion node N.m; v = load.w, x = load.phi
  rotor.a-load.a: motion node N.m; v = rotor.w - load.w, x = rotor.phi - load.phi
bodies
  one.port: storage node W; h = one.T
  two.port: storage node W; h = two.T
car
  v_b: motion equation N; v = v_b, x = body, load = (-f)
  v_w: motion equation N; v = v_w, x = wheel, load = f - k_t * (wheel - road)
  v_b-v_w: motion equation N; v = v_b - v_w, x = body - wheel
  v_w-road: motion equation N; x = wheel - road
deflection whose rate is taken
  v_b: motion equation N; v = v_b, x = body, load = (-f)
  v_w: motion equation N; v = v_w, x = wheel, load = f - k_t * (wheel - road)
  v_b-v_w: motion equation N; v = v_b - v_w, x = body - wheel
  v_w-road: motion equation N; x = wheel - road
twist that is a state
  w_1: motion equation N.m; v = w_1, load = tau + 30 * phi
  w_2: motion equation N.m; v = w_2, load = (-30 * phi) - 0.1 * w_2
  w_3: motion equation N.m; v = w_3, load = tau - 0.2 * w_3
  w_2-w_1: motion equation N.m; v = w_2 - w_1, x = phi
shaft that is a component
  motor.fl: motion node N.m; v = motor.w, x = motor.fl.phi
  load.fl: motion node N.m; v = load.w, x = load.fl.phi
  far.fl: motion node N.m; v = far.w, x = far.fl.phi
  motor.fl-load.fl: motion node N.m; v = motor.w - load.w, x = motor.fl.phi - load.fl.phi
  load.fl-far.fl: motion node N.m; v = load.w - far.w, x = load.fl.phi - far.fl.phi
oven
  T: storage equation W; h = T
  T_wall: storage equation W; h = T_wall
  T-T_hall: storage equation W; h = T, h_s = T_hall
  T_wall-T_hall: storage equation W; h = T_wall, h_s = T_hall
oven with one unit of a sum
  T: storage equation W; h = T
  T_wall: storage equation W; h = T_wall
  T-T_hall: storage equation W; h = T, h_s = T_hall
  T_wall-T_hall: storage equation W; h = T_wall, h_s = T_hall
no units
  y: storage equation -; h = y
  y-u: storage equation -; h = y, h_s = u
two without units
  z: storage equation -; h = z
  y: storage equation -; h = y
  z-u: storage equation -; h = z, h_s = u
  y-u: storage equation -; h = y, h_s = u
controller of a voltage
  w: motion equation N.m; v = w, x = phi, load = k_m * u - d * w
  u: input signal V; u = u
spring to a goal
  w: motion equation N.m; v = w, x = phi, load = k_m * u - d * w - c * (phi - goal)
  u: input signal V; u = u
  w-goal: motion equation N.m; x = phi - goal
position loop
  v: motion equation N; v = v, x = y, load = u - b * v
  z: storage equation m; h = z
  u: input signal N; u = u
  e: input signal m; u = e
position loop without units
  w: motion equation rad/s; v = w, x = phi, load = k * e - 0.3 * w
  e: input signal rad; u = e
blocks
  pi.z: storage equation -; h = pi.z
  plant.y: storage equation -; h = plant.y
  pi.y: input signal -; u = pi.y
  plant.u: input signal -; u = plant.u
  pi.z-r: storage equation -; h = pi.z, h_s = r
  plant.y-r: storage equation -; h = plant.y, h_s = r
integrators
  rate.y: motion equation -; v = rate.y, x = level.y, load = 2 * u - 0.8 * rate.y - 1.8 * level.y
  level.u: input signal -; u = level.u
integrators with a gain
  rate.y: storage equation -; h = rate.y
  level.y: storage equation -; h = level.y
  level.u: input signal -; u = level.u
cascade
  y: storage equation V; h = y
  x: storage equation V; h = x
  g: input signal V; u = g
loaded cascade
  y: storage equation V; h = y
  x: storage equation V; h = x
filters
  x[1]: storage equation V/s; h = x[1]
  x[2]: storage equation V/s; h = x[2]
  z[1]: storage equation V/s; h = z[1]
  z[2]: storage equation V/s; h = z[2]
  w: input signal V; u = w
filters and a state by another name
  x[1]: storage equation V/s; h = x[1]
  x[2]: storage equation V/s; h = x[2]
  z[1]: storage equation V/s; h = z[1]
  z[2]: storage equation V/s; h = z[2]
  w: input signal V; u = w
loaded filters
  x[1]: storage equation V/s; h = x[1]
  x[2]: storage equation V/s; h = x[2]
  z[1]: storage equation V/s; h = z[1]
  z[2]: storage equation V/s; h = z[2]
damper
  F: motion equation N; v = v, x = x
force between two masses
  v_1: motion equation N; v = v_1, x = x_1, load = a - F
  v_2: motion equation N; v = v_2, x = x_2, load = F
  F: motion equation N; v = v_1 - v_2, x = x_1 - x_2
  v_1-v_2: motion equation N; v = v_1 - v_2, x = x_1 - x_2
cell
  z: storage equation 1/s; h = z
  v: electrical equation V; i = i
charged cell
  z: storage equation 1/s; h = z
  v: electrical equation V; i = i
filter of components
  capacitor.v: storage equation A; h = capacitor.v
  capacitor.p: electrical series V; i = capacitor.p.i
  resistor.p: electrical series V; i = resistor.p.i
  leak.p: electrical series V; i = leak.p.i
grounded capacitor
  one.p: storage node A; h = one.v
  series_one.p: electrical series V; i = one.p.i
joints
  v[1]: motion equation N.m; v = v[1], x = q[1]
  v[2]: motion equation N.m; v = v[2], x = q[2]
chain
  T[1]: storage equation W; h = T[1]
  T[2]: storage equation W; h = T[2]
  T[3]: storage equation W; h = T[3]
array of components
  tank[1].h: storage equation m3/s; h = tank[1].h
  tank[2].h: storage equation m3/s; h = tank[2].h
crane
  v: motion equation N; v = v, x = x
  w: motion equation -; v = w, x = phi
each place once
  body.a: motion node N; v = body.v, x = body.a.s
  wheel.a: motion node N; v = wheel.v, x = wheel.a.s
  strut.s_rel: motion equation N; x = strut.s_rel, v = strut.v_rel, load = strut.f - strut.c * strut.s_rel
  tyre.s_rel: motion equation N; x = tyre.s_rel, v = tyre.v_rel, load = tyre.f - tyre.c * tyre.s_rel
rim of matrices
  x[1]: storage equation V; h = x[1]
  x[2]: storage equation V; h = x[2]
rim of a loop
  x[1]: storage equation -; h = x[1]
  x[2]: storage equation -; h = x[2]
rim of connectors
  plant.y[1]: storage equation -; h = plant.y[1]
  plant.y[2]: storage equation -; h = plant.y[2]
rim of states
  y[1]: storage equation m; h = y[1]
  y[2]: storage equation V; h = y[2]
"""


def expected_ports() -> dict[str, list[str]]:
    """The lines of the table by model."""
    found: dict[str, list[str]] = {}
    for line in PORTS.strip().splitlines():
        if not line.startswith(" "):
            own = found[line] = []
        else:
            own.append(line.strip())
    return {key: found.get(key) or found[key.split()[0]] for key in MODELS}
