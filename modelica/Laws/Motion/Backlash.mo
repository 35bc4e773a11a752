within Laws.Motion;
model Backlash "Lost motion of an elastic connection"
  extends Laws.Interfaces.MotionLaw;
  parameter Real k_b(min = 0, max = 10 * f_n / x_n, nominal = 0.5 * f_n / x_n) = 0 "Stiffness that is missing within the play";
  parameter Real x_b(min = 1e-3 * x_n, max = x_n, nominal = 0.1 * x_n) = 0.1 * x_n "Half width of the play";
protected
  final parameter Real x_smooth = 1e-3 * x_n "Width of the rounding at the ends of the play";
equation
  f = -k_b * 0.5 * (sqrt((x + x_b) ^ 2 + x_smooth ^ 2) - sqrt((x - x_b) ^ 2 + x_smooth ^ 2));
  annotation (Documentation(info = "<html>
<p>Within the play the connection carries nothing: the restoring force of a spring of <code>k_b</code> is taken back for up to <code>x_b</code> on either side of
the middle, and stays less by <code>k_b x_b</code> beyond.</p>
<p>Source: M. Nordin, P.-O. Gutman, Controlling mechanical systems with backlash, Automatica 38 (2002), 1633-1649.</p>
</html>"));
end Backlash;
