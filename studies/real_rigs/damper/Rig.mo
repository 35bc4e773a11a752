model Rig "A magnetorheological damper on a shaking table"
  parameter Real c(unit = "N.s/m", min = 0) = 200 "Viscous damping";
  parameter Real k(unit = "N/m", min = 0) = 200 "Stiffness";
  parameter Real F_0(unit = "N") = 50 "Force of the accumulator where the piston is at rest";
  input Real x(unit = "m") "Displacement of the piston, as measured";
  input Real v(unit = "m/s") "Velocity of the piston, as measured";
  output Real F(unit = "N") "Force of the damper, as measured";
equation
  F = c * v + k * x + F_0;
end Rig;
