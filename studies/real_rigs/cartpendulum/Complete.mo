model Rig "A cart on a belt carries a hanging pendulum"
  parameter Real b(unit = "m/(s2.V)", min = 0) = 4.414 "Acceleration of the cart by the voltage";
  parameter Real a(unit = "1/s", min = 0) = 6.288 "Damping of the cart";
  parameter Real l(unit = "1/m", min = 0) = 3.315 "Inverse of the equivalent length of the pendulum";
  parameter Real w2(unit = "rad/s2", min = 0) = 33.31 "Square of the natural frequency of small swings";
  parameter Real c(unit = "1/s", min = 0) = 0.03616 "Damping of the pendulum";
  input Real v(unit = "V") "Voltage of the cart's motor";
  output Real z(unit = "m") "Position of the cart, as measured";
  output Real phi(unit = "rad") "Angle of the pendulum, as measured";
  Real x(unit = "m", start = 0, fixed = true) "Position of the cart";
  Real s(unit = "m/s", start = 0, fixed = true) "Speed of the cart";
  Real q(unit = "rad", start = 0, fixed = true) "Angle of the pendulum, from hanging";
  Real w(unit = "rad/s", start = 0, fixed = true) "Speed of the pendulum";
equation
  der(x) = s;
  der(s) = b * v - a * s;
  der(q) = w;
  der(w) = l * cos(q) * der(s) - w2 * sin(q) - c * w;
  z = x;
  phi = q;
end Rig;
