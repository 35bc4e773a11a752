model Rig "An electric car rolls out"
  parameter Real m(unit = "kg", min = 0) = 150 "Mass with driver";
  parameter Real rho(unit = "kg/m3", min = 0) = 1.2 "Density of the air";
  parameter Real C_A(unit = "m2", min = 0) = 0.134 "Drag coefficient times area";
  parameter Real F_r(unit = "N", min = 0) = 5.57 "Rolling resistance";
  output Real speed(unit = "m/s") "Speed, as measured";
  Real v(unit = "m/s", start = 8, fixed = true) "Speed";
equation
  m * der(v) = -0.5 * rho * C_A * v ^ 2 - F_r * tanh(v / 0.01);
  speed = v;
end Rig;
