model Rig "Electromagnet of a levitator"
  parameter Real L(unit = "H", min = 0) = 0.2 "Inductance";
  parameter Real R(unit = "Ohm", min = 0) = 10 "Resistance";
  input Real u(unit = "V") "Mean voltage of the driver, as commanded";
  output Real i(unit = "A", start = 0, fixed = true) "Current, as measured";
equation
  L * der(i) = u - R * i;
end Rig;
