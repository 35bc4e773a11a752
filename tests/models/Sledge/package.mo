within ;
package Sledge "A sledge on a spring, and what its runners may do"
  connector Flange
    Real v(unit = "m/s");
    flow Real f(unit = "N");
  end Flange;
  model DryRunner "Runners that rub"
    extends Laws.Interfaces.MotionLaw;
    parameter Real F_c(min = 0, max = 10 * f_n, nominal = 0.3 * f_n) = 0 "Dry friction";
  equation
    f = F_c * tanh(v / 1e-3);
  end DryRunner;
  model Mass
    parameter Real M(unit = "kg") = 1;
    parameter Real k(unit = "N/m") = 40;
    parameter Real d(unit = "N.s/m") = 0.5;
    Flange flange;
    Real v(unit = "m/s", start = 0, fixed = true);
    Real x(unit = "m", start = 0, fixed = true);
  equation
    der(x) = v;
    M * der(v) = flange.f - k * x - d * v;
    flange.v = v;
  end Mass;
  model Push
    input Real F(unit = "N");
    Flange flange;
  equation
    flange.f = -F;
  end Push;
  model Rig
    parameter Real M(unit = "kg", min = 0.1, max = 10) = 1 "Mass";
    parameter Real k(unit = "N/m", min = 1, max = 1000) = 40 "Stiffness";
    parameter Real R_a(unit = "N.s/m", min = 0, max = 10) = 0.5 "Damping, named like another rig's resistance";
    input Real F(unit = "N");
    output Real y(unit = "m");
    Push push(F = F);
    Mass mass(M = M, k = k, d = R_a);
  equation
    connect(push.flange, mass.flange);
    y = mass.x;
  end Rig;
end Sledge;
