model Pendulum "A driven pendulum whose balance is divided by its inertia"
  parameter Real J(unit = "kg.m2") = 0.05 "Inertia about the pivot";
  parameter Real m(unit = "kg") = 0.4;
  parameter Real l(unit = "m") = 0.3;
  parameter Real d(unit = "N.m.s/rad") = 0.01;
  constant Real g(unit = "m/s2") = 9.81;
  input Real u(unit = "N.m");
  output Real angle(unit = "rad");
  Real phi(unit = "rad", start = 0.4, fixed = true);
  Real w(unit = "rad/s", start = 0, fixed = true);
protected
  Real a(unit = "rad/s2") "Angular acceleration";
equation
  der(phi) = w;
  der(w) = a;
  a = (u - d * w - m * g * l * sin(phi)) / J;
  angle = phi;
end Pendulum;
