model Rig "Two transistors on a board, each a heater with a sensor"
  parameter Real C(unit = "J/K", min = 0) = 5 "Heat capacity of a heater";
  parameter Real a1(unit = "W", min = 0) = 0.0181 "Power of the first heater by one per cent";
  parameter Real a2(unit = "W", min = 0) = 0.00712 "Power of the second heater by one per cent";
  parameter Real U(unit = "W/K", min = 0) = 0.0272 "Heat transfer of the first heater to the air";
  parameter Real V(unit = "W/K", min = 0) = 0.0218 "Heat transfer of the second heater to the air";
  parameter Real k(unit = "W/K", min = 0) = 0.00867 "Heat transfer from heater to heater";
  parameter Real T_1(unit = "s", min = 0) = 20.3 "Lag of the first sensor";
  parameter Real T_2(unit = "s", min = 0) = 13.2 "Lag of the second sensor";
  input Real Q1 "First heater, in per cent";
  input Real Q2 "Second heater, in per cent";
  input Real T_a(unit = "degC") "Temperature of the air";
  output Real T1(unit = "degC", start = 20, fixed = true) "Temperature of the first heater, as measured";
  output Real T2(unit = "degC", start = 20, fixed = true) "Temperature of the second heater, as measured";
  Real H1(unit = "degC", start = 20, fixed = true) "Temperature of the first heater";
  Real H2(unit = "degC", start = 20, fixed = true) "Temperature of the second heater";
equation
  C * der(H1) = a1 * Q1 - U * (H1 - T_a) - k * (H1 - H2);
  C * der(H2) = a2 * Q2 - V * (H2 - T_a) + k * (H1 - H2);
  T_1 * der(T1) = H1 - T1;
  T_2 * der(T2) = H2 - T2;
end Rig;
