model Rig "Electromagnet of a levitator"
  parameter Real L(unit = "H", min = 0) = 0.138 "Inductance";
  parameter Real R(unit = "Ohm", min = 0) = 11.98 "Resistance";
  parameter Real s(min = -1, max = 2) = 0.749 "Share of the command that acts by its square";
  parameter Real T_l(unit = "s", min = 0) = 0.0023 "Lag of the reading";
  input Real u(unit = "V") "Mean voltage of the driver, as commanded";
  output Real i(unit = "A", start = 0, fixed = true) "Current, as measured";
  Real j(unit = "A", start = 0, fixed = true) "Current";
  Real w(unit = "V") "Mean voltage of the driver";
equation
  w = (1 - s) * u + s * u * abs(u) / 10;
  L * der(j) = w - R * j;
  T_l * der(i) = j - i;
end Rig;
