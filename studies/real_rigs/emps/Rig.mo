model Rig "A carriage on a screw"
  parameter Real M(unit = "kg", min = 0) = 100 "Inertia at the load";
  parameter Real F_v(unit = "N.s/m", min = 0) = 150 "Viscous friction";
  input Real u(unit = "N") "Force of the motor, as measured";
  output Real q(unit = "m") "Position of the carriage, as measured";
  Real s(unit = "m", start = 0, fixed = true) "Position";
  Real v(unit = "m/s", start = 0, fixed = true) "Velocity";
equation
  der(s) = v;
  M * der(v) = u - F_v * v;
  q = s;
end Rig;
