model Rig "Two tanks, one above the other; levels and pump in volts of their electronics"
  parameter Real k1 = 0.05 "Outflow of the upper tank";
  parameter Real k2 = 0.05 "Inflow of the lower tank";
  parameter Real k3 = 0.03 "Pump";
  parameter Real k4 = 0.05 "Outflow of the lower tank";
  input Real u "Voltage of the pump";
  output Real y "Level of the lower tank";
  Real h1(start = 3, fixed = true, min = 0) "Level of the upper tank";
  Real h2(start = 3, fixed = true, min = 0) "Level of the lower tank";
equation
  der(h1) = k3 * u - k1 * sqrt(h1);
  der(h2) = k2 * sqrt(h1) - k4 * sqrt(h2);
  y = h2;
end Rig;
