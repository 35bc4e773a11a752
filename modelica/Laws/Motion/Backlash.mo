within Laws.Motion;
model Backlash "Lost motion of an elastic connection"
  extends Laws.Interfaces.MotionLaw;
  parameter Real k_b(min = 0, max = 10 * f_n / x_n, nominal = 0.5 * f_n / x_n) = 0 "Stiffness that is missing within the play";
  parameter Real x_b(min = 1e-3 * x_n, max = x_n, nominal = 0.1 * x_n) = 0.1 * x_n "Half width of the play";
  parameter Real t_b(min = 0, max = t_n, nominal = 0.001 * t_n) = 0 "Damping that is missing within the play, over the stiffness";
protected
  final parameter Real x_smooth = 1e-3 * x_n "Width of the rounding at the ends of the play";
  final parameter Real x_push = 0.1 * x_smooth "Width of the rounding where a contact would begin to pull";
  Real e_1 "Displacement beyond the upper end of the play";
  Real e_2 "Displacement beyond the lower end of the play";
  Real p_1 "Force of the contact above over its stiffness";
  Real p_2 "Force of the contact below over its stiffness";
equation
  e_1 = 0.5 * (x - x_b + sqrt((x - x_b) ^ 2 + x_smooth ^ 2));
  e_2 = 0.5 * (-x - x_b + sqrt((x + x_b) ^ 2 + x_smooth ^ 2));
  p_1 = e_1 + t_b * v * e_1 / sqrt(e_1 ^ 2 + x_smooth ^ 2);
  p_2 = e_2 - t_b * v * e_2 / sqrt(e_2 ^ 2 + x_smooth ^ 2);
  f = k_b * (0.5 * (p_1 + sqrt(p_1 ^ 2 + x_push ^ 2) - p_2 - sqrt(p_2 ^ 2 + x_push ^ 2)) - x - t_b * v);
  annotation (Documentation(info = "<html>
<p>Within the play the connection carries nothing: the force of a spring of <code>k_b</code>, and of a damper of <code>k_b t_b</code> beside it, is taken back;
beyond it they act from its end on, and push but never pull.</p>
<p>Source: M. Nordin, P.-O. Gutman, Controlling mechanical systems with backlash, Automatica 38 (2002), 1633-1649.</p>
</html>"));
end Backlash;
