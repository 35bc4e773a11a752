model Rig "Hobby servo that turns a weight"
  parameter Real T(unit = "s", min = 0) = 0.1 "Time constant of the position control";
  input Real command(unit = "rad") "Angle asked for";
  output Real angle(unit = "rad") "Angle, as measured";
  Real phi(unit = "rad", start = 0, fixed = true) "Angle of the horn";
equation
  T * der(phi) = command - phi;
  angle = phi;
end Rig;
