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
  model DryRunner "Runners that rub"
    extends Effect;
    parameter Real F_c(unit = "N", min = 0, max = 5, nominal = 0.3) = 0 "Dry friction";
  equation
    flange.f = F_c * tanh(flange.v / 1e-3);
  end DryRunner;
  model WetRunner "Runners that push snow"
    extends Effect;
    parameter Real c_q(unit = "N.s2/m2", min = 0, max = 20, nominal = 1) = 0 "Drag";
  equation
    flange.f = c_q * flange.v * abs(flange.v);
  end WetRunner;
  model RateCurve
    extends Effect;
    parameter Real x_n(unit = "m/s") = 1;
    parameter Real c_1(unit = "N", min = -10, max = 10, nominal = 1) = 0 "Force going backwards";
    parameter Real c_2(unit = "N", min = -10, max = 10, nominal = 1) = 0 "Force going forwards";
    Real x(unit = "m/s") "Speed";
    Real y(unit = "N") "Force against the motion";
  equation
    x = flange.v;
    y = c_1 * exp(-2 * (x / x_n + 1) ^ 2) + c_2 * exp(-2 * (x / x_n - 1) ^ 2);
    flange.f = y;
    annotation (__aero_bayes(learned = "x"));
  end RateCurve;
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
    replaceable model Runner = NoEffect constrainedby Effect "Under the sledge";
    input Real F(unit = "N");
    output Real y(unit = "m");
    Runner runner;
    Mass mass(M = M, k = k, d = R_a, F = F);
  equation
    connect(runner.flange, mass.flange);
    y = mass.x;
  end Rig;
end Sledge;
