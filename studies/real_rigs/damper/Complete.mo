model Rig "A magnetorheological damper on a shaking table"
  parameter Real c(unit = "N.s/m", min = 0) = 744 "Viscous damping";
  parameter Real k(unit = "N/m", min = 0) = 1460 "Stiffness";
  parameter Real F_0(unit = "N") = 114 "Force of the accumulator where the piston is at rest";
  parameter Real F_c(unit = "N", min = 0) = 65.4 "Dry friction";
  parameter Real v_c(unit = "m/s", min = 1e-5) = 0.0037 "Speed over which it changes its sign";
  input Real x(unit = "m") "Displacement of the piston, as measured";
  input Real v(unit = "m/s") "Velocity of the piston, as measured";
  output Real F(unit = "N") "Force of the damper, as measured";
equation
  F = c * v + k * x + F_0 + F_c * tanh(v / v_c);
end Rig;
