model Rig "A carriage on a screw"
  parameter Real M(unit = "kg", min = 0) = 96.8 "Inertia at the load";
  parameter Real F_v(unit = "N.s/m", min = 0) = 220 "Viscous friction";
  parameter Real F_c(unit = "N", min = 0) = 18.8 "Dry friction";
  parameter Real F_0(unit = "N") = -3.26 "Offset of the force";
  input Real u(unit = "N") "Force of the motor, as measured";
  output Real q(unit = "m") "Position of the carriage, as measured";
  Real s(unit = "m", start = 0, fixed = true) "Position";
  Real v(unit = "m/s", start = 0, fixed = true) "Velocity";
equation
  der(s) = v;
  M * der(v) = u - F_v * v - F_c * tanh(v / 1e-4) - F_0;
  q = s;
end Rig;
