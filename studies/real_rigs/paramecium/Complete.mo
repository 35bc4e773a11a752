model Rig "A culture grows"
  parameter Real r(unit = "1/s", min = 0) = 7.74e-06 "Rate of growth";
  parameter Real c(unit = "1/s", min = 0) = 1.32e-08 "Crowding";
  output Real count "Individuals in a sample, as counted";
  Real N(start = 2, fixed = true, min = 0) "Individuals";
equation
  der(N) = r * N - c * N ^ 2;
  count = N;
end Rig;
