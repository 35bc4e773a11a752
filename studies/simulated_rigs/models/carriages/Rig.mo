model Rig "Two carriages coupled by a spring, the first tied to a wall, both driven"
  parameter Real m1(unit = "kg", min = 0) = 2 "Mass of the first carriage";
  parameter Real m2(unit = "kg", min = 0) = 1 "Mass of the second carriage";
  parameter Real k1(unit = "N/m", min = 0) = 80 "Spring to the wall";
  parameter Real k2(unit = "N/m", min = 0) = 50 "Spring between the carriages";
  parameter Real d1(unit = "N.s/m", min = 0) = 3 "Damper to the wall";
  parameter Real d2(unit = "N.s/m", min = 0) = 0.8 "Damper between the carriages";
  input Real f1(unit = "N") "Force on the first carriage";
  input Real f2(unit = "N") "Force on the second carriage";
  output Real x1(unit = "m") "Position of the first, as measured";
  output Real x2(unit = "m") "Position of the second, as measured";
  Real s1(unit = "m", start = 0, fixed = true) "Position of the first carriage";
  Real v1(unit = "m/s", start = 0, fixed = true) "Velocity of the first carriage";
  Real s2(unit = "m", start = 0, fixed = true) "Position of the second carriage";
  Real v2(unit = "m/s", start = 0, fixed = true) "Velocity of the second carriage";
  Real pull(unit = "N") "Force of the coupling on the first carriage";
equation
  pull = k2 * (s2 - s1) + d2 * (v2 - v1);
  der(s1) = v1;
  m1 * der(v1) = f1 - k1 * s1 - d1 * v1 + pull;
  der(s2) = v2;
  m2 * der(v2) = f2 - pull;
  x1 = s1;
  x2 = s2;
end Rig;
