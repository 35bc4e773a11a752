within ;
package Sledge "A sledge on a spring, with a place for what its runners do"
  connector Flange
    Real v(unit = "m/s");
    flow Real f(unit = "N");
  end Flange;
  partial model Effect
    Flange flange;
  end Effect;
  model NoEffect
    extends Effect;
  equation
    flange.f = 0;
  end NoEffect;
  model DryRunner
    extends Effect;
    parameter Real F_c(unit = "N") = 0;
  equation
    flange.f = F_c * tanh(flange.v / 1e-3);
  end DryRunner;
  model WetRunner
    extends Effect;
    parameter Real c_q(unit = "N.s2/m2") = 0;
  equation
    flange.f = c_q * flange.v * abs(flange.v);
  end WetRunner;
  model Probe
    extends Effect;
    input Real u(unit = "N");
  equation
    flange.f = -u;
  end Probe;
  model Curve
    extends Effect;
    parameter Real x_min = -1;
    parameter Real x_max = 1;
    parameter Real c[:] = {0, 0, 0};
  equation
    flange.f = Aero.Functions.smoothTable(flange.v, x_min, x_max, c);
  end Curve;
  model Mass
    parameter Real M(unit = "kg") = 1;
    parameter Real k(unit = "N/m") = 40;
    parameter Real d(unit = "N.s/m") = 0.5;
    input Real F(unit = "N");
    Flange flange;
    Real v(unit = "m/s", start = 0, fixed = true);
    Real x(unit = "m", start = 0, fixed = true);
  equation
    der(x) = v;
    M * der(v) = F - k * x - d * v + flange.f;
    flange.v = v;
  end Mass;
  model Rig
    parameter Real M(unit = "kg", min = 0.1, max = 10) = 1 "Mass";
    parameter Real k(unit = "N/m", min = 1, max = 1000) = 40 "Stiffness";
    parameter Real R_a(unit = "N.s/m", min = 0, max = 10) = 0.5 "Damping, named like another rig's resistance";
    replaceable model Runner = NoEffect constrainedby Effect;
    input Real F(unit = "N");
    output Real y(unit = "m");
    Runner runner;
    Mass mass(M = M, k = k, d = R_a, F = F);
  equation
    connect(runner.flange, mass.flange);
    y = mass.x;
  end Rig;
end Sledge;
