model Rig "Battery cell: an open-circuit voltage that falls with the charge drawn, and a resistance"
  parameter Real E_0(unit = "V", min = 2, max = 4) = 3.3 "Open-circuit voltage where the recording begins";
  parameter Real k(unit = "V/C", min = 0, max = 1e-3) = 1e-5 "Fall of the open-circuit voltage with the charge drawn";
  parameter Real R(unit = "Ohm", min = 0, max = 1) = 0.01 "Resistance of the cell";
  input Real i(unit = "A") "Current, positive where the cell discharges";
  output Real v(unit = "V") "Voltage of the terminals, as measured";
  Real q(unit = "C", start = 0, fixed = true) "Charge drawn";
equation
  der(q) = i;
  v = E_0 - k * q - R * i;
end Rig;
