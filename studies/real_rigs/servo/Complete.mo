model Rig "Hobby servo that turns a weight"
  parameter Real T(unit = "s", min = 0) = 0.0548 "Time constant of the position control";
  parameter Real r(unit = "rad/s", min = 0.1) = 1.83 "Largest rate";
  input Real command(unit = "rad") "Angle asked for";
  output Real angle(unit = "rad") "Angle, as measured";
  Real phi(unit = "rad", start = 0, fixed = true) "Angle of the horn";
  Real z(unit = "rad", start = 0, fixed = true) "Angle asked for, as the rate allows";
equation
  der(z) = max(-r, min(r, (command - z) / 0.005));
  T * der(phi) = z - phi;
  angle = phi;
end Rig;
