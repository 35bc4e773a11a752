model Falling "A light ball in a vacuum"
  parameter Real m(unit = "kg") = 0.03;
  parameter Real g(unit = "m/s2", min = 9.79, max = 9.82) = 9.81;
  output Real height(unit = "m");
  Real z(unit = "m", start = 50, fixed = true);
  Real v(unit = "m/s", start = 0, fixed = true);
equation
  der(z) = v;
  m * der(v) = -m * g;
  height = z;
end Falling;
