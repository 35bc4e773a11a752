model Rig "Two tanks, one above the other, both levels measured; levels and pump in volts of their electronics"
  parameter Real k1(min = 0) = 0.0418 "Outflow of the upper tank";
  parameter Real k2(min = 0) = 0.0434 "Inflow of the lower tank";
  parameter Real k3(min = 0) = 0.0594 "Pump";
  parameter Real k4(min = 0) = 0.0444 "Outflow of the lower tank";
  parameter Real s(min = -2, max = 2) = -0.444 "Share of the pump that goes by the square of its voltage";
  input Real u "Voltage of the pump";
  output Real y1 "Level of the upper tank, as measured";
  output Real y2 "Level of the lower tank, as measured";
  Real h1(start = 1, fixed = true, min = 0) "Level of the upper tank";
  Real h2(start = 1, fixed = true, min = 0) "Level of the lower tank";
equation
  der(h1) = k3 * ((1 - s) * u + s * u * abs(u) / 2) - k1 * sqrt(h1);
  der(h2) = k2 * sqrt(h1) - k4 * sqrt(h2);
  y1 = h1;
  y2 = h2;
end Rig;
