model Rig "Electronic oscillator in the units of its plugs"
  parameter Real m = 1e-3;
  parameter Real d = 0.015;
  parameter Real k = 1.5;
  input Real u;
  output Real y;
  Real x(start = 0, fixed = true);
  Real v(start = 0, fixed = true);
equation
  der(x) = v;
  m * der(v) = u - d * v - k * x;
  y = x;
end Rig;
