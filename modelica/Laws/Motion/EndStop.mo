within Laws.Motion;
model EndStop "Stops that a motion runs into"
  extends Laws.Interfaces.MotionLaw;
  parameter Real k_s(min = 0, max = 1000 * f_n / x_n, nominal = 10 * f_n / x_n) = 0 "Stiffness of the stops";
  parameter Real x_s(min = 0.05 * x_n, max = x_n, nominal = 0.8 * x_n) = 0.8 * x_n "Displacement at which the stops are met";
protected
  final parameter Real x_smooth = 1e-5 * x_n "Width of the rounding where a stop is met";
equation
  f = k_s * (x + 0.5 * (sqrt((x - x_s) ^ 2 + x_smooth ^ 2) - sqrt((x + x_s) ^ 2 + x_smooth ^ 2)));
  annotation (Documentation(info = "<html>
<p>An elastic stop at <code>x_s</code> and one at <code>-x_s</code>; between them nothing acts. A motion that meets one of them only is described as well.</p>
<p>Source: B. Brogliato, Nonsmooth Mechanics (Springer, 2016), sec. 2.1: compliant contact.</p>
</html>"));
end EndStop;
