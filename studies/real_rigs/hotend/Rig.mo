model Rig "Hot end of a printer"
  parameter Real C(unit = "J/K", min = 0) = 10 "Heat capacity";
  parameter Real G(unit = "W/K", min = 0) = 0.1 "Heat transfer to the air";
  parameter Real T_a(unit = "degC", min = 15, max = 40) = 25 "Temperature of the air";
  input Real u(unit = "W") "Power of the heater";
  output Real T(unit = "degC", start = 25, fixed = true) "Temperature, as measured";
equation
  C * der(T) = u - G * (T - T_a);
end Rig;
