within Aero.Functions;
function smoothTable "Curve through values at equally spaced knots, straight beyond the outer ones"
  input Real x "Abscissa";
  input Real x_min "First knot";
  input Real x_max "Last knot";
  input Real c[:] "Values at the knots, at least two";
  output Real y "Value of the curve";
protected
  Integer n = size(c, 1);
  Real at "Position in knot distances";
  Real s "Position within the knots, from 0 to n - 1";
  Real d "Distance from a knot";
algorithm
  at := (x - x_min) / (x_max - x_min) * (n - 1);
  s := min(max(at, 0), n - 1);
  // the knots beyond both ends lie on straight lines through the outer two
  d := s + 1;
  y := (2 * c[1] - c[2]) * (if d < 2 then ((2.5 - 0.5 * d) * d - 4) * d + 2 else 0);
  d := n - s;
  y := y + (2 * c[n] - c[n - 1]) * (if d < 2 then ((2.5 - 0.5 * d) * d - 4) * d + 2 else 0);
  y := y + min(at, 0) * (c[2] - c[1]) + max(at - (n - 1), 0) * (c[n] - c[n - 1]);
  for k in 1:n loop
    d := abs(s - (k - 1));
    y := y + c[k] * (if d < 1 then (1.5 * d - 2.5) * d * d + 1 else if d < 2 then ((2.5 - 0.5 * d) * d - 4) * d + 2 else 0);
  end for;
  annotation (
    Documentation(info = "<html><p>Cubic convolution (Keys 1981): the curve and its slope are continuous, it passes through the values, and each value acts over two
knots on either side. Beyond the outer knots it goes on as a straight line with the slope it has there.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-80, -40}, {-40, 30}, {20, -10}, {80, 60}}, color = {40, 80, 140}, smooth = Smooth.Bezier)}));
end smoothTable;
