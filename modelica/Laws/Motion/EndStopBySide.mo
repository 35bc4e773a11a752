within Laws.Motion;
model EndStopBySide "Stops that a motion runs into, at different distances"
  extends Laws.Interfaces.MotionLaw;
  parameter Real k_s(min = 0, max = 1000 * f_n / x_w, nominal = 10 * f_n / x_w) = 0 "Stiffness of the stops";
  parameter Real x_s(min = 0.05 * x_w, max = 1.2 * x_w, nominal = 0.95 * x_w) = 0.95 * x_w "Displacement from the middle at which the stops are met";
  parameter Real b(min = -x_w, max = x_w, nominal = 0.01 * x_w) = 0 "How far the middle between the stops is from that of the range";
protected
  final parameter Real x_smooth = 1e-5 * x_w "Width of the rounding where a stop is met";
  Real e "Displacement from the middle between the stops";
equation
  e = x - x_0 - b;
  f = k_s * (e + 0.5 * (sqrt((e - x_s) ^ 2 + x_smooth ^ 2) - sqrt((e + x_s) ^ 2 + x_smooth ^ 2)));
  annotation (__aero_bayes(refines = "end_stop"),
    Documentation(info = "<html>
<p>An elastic stop on either side of a middle, <code>x_s</code> from it; between them nothing acts. The middle is <code>b</code> from that of the range in
which the motion was seen.</p>
<p>Source: B. Brogliato, Nonsmooth Mechanics (Springer, 2016), sec. 2.1: compliant contact.</p>
</html>"));
end EndStopBySide;
