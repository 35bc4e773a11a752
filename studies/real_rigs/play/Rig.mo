model Rig "A motor turns an inertia that a spring draws back"
  parameter Real k_m(unit = "N.m/V", min = 0) = 1 "Torque of the motor by its voltage";
  parameter Real J(unit = "kg.m2", min = 0) = 0.05 "Moment of inertia, weighed";
  parameter Real D(unit = "N.m.s/rad", min = 0) = 0.2 "Viscous friction";
  parameter Real c(unit = "N.m/rad", min = 0) = 20 "Stiffness of the spring";
  input Real u(unit = "V") "Voltage of the motor";
  output Real angle(unit = "rad") "Angle, as measured";
  Real phi(unit = "rad", start = 0, fixed = true) "Angle";
  Real w(unit = "rad/s", start = 0, fixed = true) "Speed";
equation
  der(phi) = w;
  J * der(w) = k_m * u - D * w - c * phi;
  angle = phi;
end Rig;
