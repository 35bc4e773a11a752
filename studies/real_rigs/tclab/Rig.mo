model Rig "Two transistors on a board, each a heater with a sensor"
  parameter Real C(unit = "J/K", min = 0) = 5 "Heat capacity of a heater";
  parameter Real a1(unit = "W", min = 0) = 0.01 "Power of the first heater by one per cent";
  parameter Real a2(unit = "W", min = 0) = 0.005 "Power of the second heater by one per cent";
  parameter Real U(unit = "W/K", min = 0) = 0.04 "Heat transfer of a heater to the air";
  input Real Q1 "First heater, in per cent";
  input Real Q2 "Second heater, in per cent";
  input Real T_a(unit = "degC") "Temperature of the air";
  output Real T1(unit = "degC", start = 20, fixed = true) "Temperature of the first heater, as measured";
  output Real T2(unit = "degC", start = 20, fixed = true) "Temperature of the second heater, as measured";
equation
  C * der(T1) = a1 * Q1 - U * (T1 - T_a);
  C * der(T2) = a2 * Q2 - U * (T2 - T_a);
end Rig;
