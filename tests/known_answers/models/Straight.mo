model Straight "Linear in its three parameters"
  parameter Real a(min = -100, max = 100) = 0 "Level";
  parameter Real b(min = -100, max = 100) = 0 "Slope";
  parameter Real c(min = -100, max = 100) = 0 "Weight of a decay";
  output Real y = a + b * s + c * d "A line and a decay";
  Real s(start = 0, fixed = true) "Time";
  Real d(start = 1, fixed = true) "Decay in 2 s";
equation
  der(s) = 1;
  der(d) = -0.5 * d;
end Straight;
