model Motor "DC motor by its equations"
  parameter Real R(unit = "Ohm") = 1;
  parameter Real L(unit = "H") = 0.01;
  parameter Real k(unit = "N.m/A") = 0.1;
  parameter Real J(unit = "kg.m2") = 1e-3;
  parameter Real d(unit = "N.m.s/rad") = 1e-4;
  input Real V(unit = "V") "Voltage";
  output Real speed(unit = "rad/s") "Speed";
  output Real current(unit = "A") = i;
  Real i(unit = "A", start = 0, fixed = true);
  Real w(unit = "rad/s", start = 0, fixed = true);
  Real tau(unit = "N.m") = k * i "Torque of the motor";
equation
  L * der(i) = V - R * i - k * w;
  J * der(w) + d * w = tau;
  speed = w;
end Motor;
