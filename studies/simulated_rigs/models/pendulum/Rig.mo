model Rig "Pendulum driven by a torque at its pivot"
  parameter Real J(unit = "kg.m2", min = 0) = 0.05 "Moment of inertia about the pivot";
  parameter Real D(unit = "N.m.s/rad", min = 0) = 0.06 "Viscous damping of the pivot";
  parameter Real G(unit = "N.m", min = 0) = 1.2 "Weight times distance of the centre of mass";
  input Real tau(unit = "N.m") "Torque of the drive";
  output Real angle(unit = "rad") "Angle, as measured";
  Real phi(unit = "rad", start = 0, fixed = true) "Angle from hanging";
  Real omega(unit = "rad/s", start = 0, fixed = true) "Angular velocity";
equation
  der(phi) = omega;
  J * der(omega) = tau - D * omega - G * sin(phi);
  angle = phi;
end Rig;
