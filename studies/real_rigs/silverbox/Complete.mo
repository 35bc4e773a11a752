model Rig "Electronic oscillator, in the volts of its plugs"
  parameter Real m(min = 0) = 5.1665e-06 "Inertia";
  parameter Real d(min = 0) = 0.00021576 "Damping";
  parameter Real a(min = 0) = 0.95219 "Stiffness";
  parameter Real a_3(min = 0) = 3.794 "Stiffness that grows with the square of the displacement";
  input Real u "Voltage that drives it";
  output Real y "Displacement, as measured";
  Real x(start = 0, fixed = true) "Displacement";
  Real v(start = 0, fixed = true) "Velocity";
equation
  der(x) = v;
  m * der(v) = u - d * v - a * x - a_3 * x ^ 3;
  y = x;
end Rig;
