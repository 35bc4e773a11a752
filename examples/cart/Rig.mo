model Rig "A cart on a rail, held by a spring and pushed by a linear motor"
  parameter Real m(unit = "kg", min = 0) = 1.2 "Mass of the cart (weighed)";
  parameter Real k(unit = "N/m", min = 0) = 50 "Stiffness of the spring";
  parameter Real d(unit = "N.s/m", min = 0) = 3 "Damping of the cart's bearings";
  input Real F(unit = "N") "Force of the motor";
  output Real position(unit = "m") "Position, as measured";
  Real s(unit = "m", start = 0, fixed = true) "Position of the cart";
  Real v(unit = "m/s", start = 0, fixed = true) "Velocity of the cart";
equation
  der(s) = v;
  // The motor pushes, the spring pulls back, the bearings brake.
  m * der(v) = F - k * s - d * v;
  position = s;
end Rig;
