model Rig "Battery cell: an open-circuit voltage that falls with the charge drawn, and a resistance"
  parameter Real E_0(unit = "V", min = 2, max = 4) = 3.343 "Open-circuit voltage where the recording begins";
  parameter Real k(unit = "V/C", min = 0, max = 1e-3) = 1.55e-05 "Fall of the open-circuit voltage with the charge drawn";
  parameter Real R(unit = "Ohm", min = 0, max = 1) = 0.01005 "Resistance of the cell";
  parameter Real R_1(unit = "Ohm", min = 0) = 0.0086 "Resistance of the fast pair";
  parameter Real T_1(unit = "s", min = 1) = 19.3 "Time constant of the fast pair";
  parameter Real R_2(unit = "Ohm", min = 0) = 0.0286 "Resistance of the slow pair";
  parameter Real T_2(unit = "s", min = 100) = 337 "Time constant of the slow pair";
  input Real i(unit = "A") "Current, positive where the cell discharges";
  output Real v(unit = "V") "Voltage of the terminals, as measured";
  Real q(unit = "C", start = 0, fixed = true) "Charge drawn";
  Real v_1(unit = "V", start = 0, fixed = true) "Voltage of the fast pair";
  Real v_2(unit = "V", start = 0, fixed = true) "Voltage of the slow pair";
equation
  T_1 * der(v_1) = R_1 * i - v_1;
  T_2 * der(v_2) = R_2 * i - v_2;
  der(q) = i;
  v = E_0 - k * q - R * i - v_1 - v_2;
end Rig;
