model Rig "A culture grows"
  parameter Real r(unit = "1/s", min = 0) = 1e-5 "Rate of growth";
  output Real count "Individuals in a sample, as counted";
  Real N(start = 2, fixed = true, min = 0) "Individuals";
equation
  der(N) = r * N;
  count = N;
end Rig;
