within Laws.Motion;
model EndStopBySide "Stops that a motion runs into, at different distances, which give back less than they take"
  extends Laws.Interfaces.MotionLaw;
  parameter Real k_s(min = 0, max = 1000 * f_n / x_w, nominal = 10 * f_n / x_w) = 0 "Stiffness of the stops";
  parameter Real x_s(min = 0.05 * x_w, max = 1.05 * x_w, nominal = 0.95 * x_w) = 0.95 * x_w "Displacement from the middle at which the stops are met";
  parameter Real b(min = -x_w, max = x_w, nominal = 0.01 * x_w) = 0 "How far the middle between the stops is from that of the range";
  parameter Real t_s(min = 0, max = t_n, nominal = 0.001 * t_n) = 0 "Damping of the stops over their stiffness";
protected
  final parameter Real x_smooth = 1e-5 * x_w "Width of the rounding where a stop is met";
  final parameter Real x_d = 1e-3 * x_w "Displacement over which the damping sets in";
  Real e "Displacement from the middle between the stops";
  Real e_1 "Displacement into the stop above";
  Real e_2 "Displacement into the stop below";
  Real p_1 "Force of the stop above over its stiffness";
  Real p_2 "Force of the stop below over its stiffness";
equation
  e = x - x_0 - b;
  e_1 = 0.5 * (e - x_s + sqrt((e - x_s) ^ 2 + x_smooth ^ 2));
  e_2 = 0.5 * (-e - x_s + sqrt((e + x_s) ^ 2 + x_smooth ^ 2));
  p_1 = e_1 + t_s * v * e_1 / sqrt(e_1 ^ 2 + x_d ^ 2);
  p_2 = e_2 - t_s * v * e_2 / sqrt(e_2 ^ 2 + x_d ^ 2);
  f = 0.5 * k_s * (p_1 + sqrt(p_1 ^ 2 + x_smooth ^ 2) - p_2 - sqrt(p_2 ^ 2 + x_smooth ^ 2));
  annotation (__aero_bayes(refines = "end_stop"),
    Documentation(info = "<html>
<p>An elastic stop on either side of a middle, <code>x_s</code> from it, with damping <code>k_s * t_s</code> while it is pressed; it pushes and never
pulls. Between them nothing acts. The middle is <code>b</code> from that of the range in which the motion was seen.</p>
<p>Source: B. Brogliato, Nonsmooth Mechanics (Springer, 2016), sec. 2.1: compliant contact, with the damper of Kelvin and Voigt.</p>
</html>"));
end EndStopBySide;
