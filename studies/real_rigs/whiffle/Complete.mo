model Rig "A light ball falls"
  parameter Real m(unit = "kg", min = 0) = 0.03 "Mass of the ball";
  parameter Real g(unit = "m/s2", min = 9.79, max = 9.82) = 9.82 "Acceleration of gravity";
  parameter Real d(unit = "N.s/m", min = 0) = 0.0172 "Drag of the air";
  output Real height(unit = "m") "Height, as measured";
  Real z(unit = "m", start = 47, fixed = true) "Height";
  Real v(unit = "m/s", start = 0, fixed = true) "Velocity, upwards";
equation
  der(z) = v;
  m * der(v) = -m * g - d * v;
  height = z;
end Rig;
