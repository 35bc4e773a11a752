within Aero.Functions;
function bumps "Overlapping bumps at equally spaced places from -1 to 1"
  input Real x "Abscissa";
  input Real c[:] "Heights of the bumps, at least two";
  output Real y "Their sum";
protected
  Integer n = size(c, 1);
algorithm
  y := 0;
  for k in 1:n loop
    y := y + c[k] * exp(-0.5 * (0.5 * (n - 1) * (x + 1) - (k - 1)) ^ 2);
  end for;
  annotation (
    Documentation(info = "<html>
<p>Gaussian bumps as wide as the distance between two of them: linear in their heights, and smooth.</p>
<p>Source: M. J. D. Powell, Radial basis functions for multivariable interpolation, in: Algorithms for Approximation (Oxford, 1987), 143-167.</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-80, -60}, {-40, 50}, {0, -30}, {40, 60}, {80, -60}}, color = {40, 80, 140}, smooth = Smooth.Bezier)}));
end bumps;
