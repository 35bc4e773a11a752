model Plant "Mass on a spring, its acceleration read"
  parameter Real m(min = 0.01, max = 100, unit = "kg") = 2;
  parameter Real d(min = 0.01, max = 100, unit = "N.s/m") = 1;
  parameter Real k(min = 0.01, max = 1000, unit = "N/m") = 10;
  input Real u(unit = "N");
  output Real x(unit = "m", start = 0.1, fixed = true);
  Real v(unit = "m/s", start = 0, fixed = true);
  output Real a(unit = "m/s2");
equation
  der(x) = v;
  m * der(v) = u - d * v - k * x;
  a = der(v);
end Plant;
