model Rig "A servo motor turns a second one"
  parameter Real J(unit = "kg.m2", min = 0) = 3e-4 "Moment of inertia of both";
  parameter Real B(unit = "N.m.s/rad", min = 0) = 1e-4 "Viscous friction";
  input Real tau(unit = "N.m") "Torque of the motor, as commanded";
  output Real w(unit = "rad/s", start = 0, fixed = true) "Speed, as measured";
equation
  J * der(w) = tau - B * w;
end Rig;
