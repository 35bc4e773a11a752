model Rig "Hot end of a printer"
  parameter Real C(unit = "J/K", min = 0) = 59 "Heat capacity";
  parameter Real G(unit = "W/K", min = 0) = 0.187 "Heat transfer to the air";
  parameter Real T_a(unit = "degC", min = 15, max = 40) = 40 "Temperature of the air";
  parameter Real T_d(unit = "s", min = 0.1) = 7.06 "Delay of the sensor";
  input Real u(unit = "W") "Power of the heater";
  output Real T(unit = "degC") "Temperature, as measured";
  Real H(unit = "degC", start = 25, fixed = true) "Temperature";
  Real x_1(unit = "degC", start = 25, fixed = true) "Temperature after a third of the delay";
  Real x_2(unit = "degC", start = 25, fixed = true) "Temperature after two thirds of the delay";
  Real x_3(unit = "degC", start = 25, fixed = true) "Temperature after the delay, as three lags";
equation
  C * der(H) = u - G * (H - T_a);
  T_d / 3 * der(x_1) = H - x_1;
  T_d / 3 * der(x_2) = x_1 - x_2;
  T_d / 3 * der(x_3) = x_2 - x_3;
  T = x_3;
end Rig;
