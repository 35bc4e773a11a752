model TankPair "Two tanks, the upper one fed by a pump"
  parameter Real k_1(min = 0.01, max = 1) = 0.08 "Outflow of the upper tank";
  parameter Real k_2(min = 0.01, max = 1) = 0.08 "Inflow of the lower tank";
  parameter Real k_3(min = 0.01, max = 1) = 0.05 "Pump";
  parameter Real k_4(min = 0.01, max = 1) = 0.07 "Outflow of the lower tank";
  input Real u(unit = "V") "Pump voltage";
  output Real y(unit = "V") "Level of the lower tank";
  Real h1(unit = "V", start = 4, fixed = true, min = 0) "Level of the upper tank";
  Real h2(unit = "V", start = 3, fixed = true, min = 0) "Level of the lower tank";
equation
  der(h1) = k_3 * u - k_1 * sqrt(noEvent(max(h1, 1e-6)));
  /* what leaves the upper tank
     enters the lower one */
  der(h2) = k_2 * sqrt(noEvent(max(h1, 1e-6))) - k_4 * sqrt(noEvent(max(h2, 1e-6)));
  y = h2;
end TankPair;
