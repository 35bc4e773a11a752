model Rig "Two tanks, one above the other; levels and pump in volts of their electronics"
  parameter Real k1 = 0.0477 "Outflow of the upper tank";
  parameter Real k2 = 0.0474 "Inflow of the lower tank";
  parameter Real k3 = 0.0388 "Pump";
  parameter Real k4 = 0.0461 "Outflow of the lower tank";
  parameter Real k_o(min = 0) = 50 "Overflow of the upper tank by the level above its edge";
  parameter Real h_o(min = 1, max = 15) = 9.08 "Level of the edge";
  parameter Real b(min = 0, max = 1) = 0.83 "Share of the overflow that falls into the lower tank";
  input Real u "Voltage of the pump";
  output Real y "Level of the lower tank, as measured";
  Real h1(start = 5, fixed = true, min = 0) "Level of the upper tank";
  Real h2(start = 5, fixed = true, min = 0) "Level of the lower tank";
equation
  der(h1) = k3 * u - k1 * sqrt(h1) - k_o * max(h1 - h_o, 0);
  der(h2) = k2 * sqrt(h1) - k4 * sqrt(h2) + b * k_o * max(h1 - h_o, 0);
  y = h2;
end Rig;
