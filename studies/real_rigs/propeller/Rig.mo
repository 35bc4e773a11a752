model Rig "A coreless motor turns a propeller"
  parameter Real J(unit = "kg.m2", min = 0) = 1e-7 "Moment of inertia";
  parameter Real k(unit = "N.m/V", min = 0) = 1e-4 "Torque by voltage";
  parameter Real b(unit = "N.m.s/rad", min = 0) = 2e-7 "Drag and induced voltage";
  input Real V(unit = "V") "Voltage of the motor";
  output Real omega(unit = "rad/s") "Speed, as measured";
  Real w(unit = "rad/s", start = 0, fixed = true) "Speed";
equation
  J * der(w) = k * V - b * w;
  omega = w;
end Rig;
