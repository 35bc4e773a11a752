within Laws.Motion;
model HystereticSpring "A spring whose force depends on where it came from"
  extends Laws.Interfaces.MotionLaw;
  parameter Real k_h(min = 0, max = 10 * f_n / x_n, nominal = 0.3 * f_n / x_n) = 0 "Stiffness where the motion turns";
  parameter Real x_h(min = 1e-3 * x_n, max = 10 * x_n, nominal = 0.5 * x_n) = 0.5 * x_n "Displacement over which it yields";
  parameter Real s(min = -2, max = 2, nominal = 0.5) = 0 "How much more it yields on the way out than on the way back";
  Real z(start = 0, fixed = true, nominal = 1) "Force, in units of k_h x_h";
protected
  final parameter Real v_smooth = 1e-5 * v_n "Width of the rounding at rest";
equation
  x_h * der(z) = v - sqrt(v ^ 2 + v_smooth ^ 2) * z - s * v * sqrt(z ^ 2 + 1e-6);
  f = k_h * x_h * z;
  annotation (__aero_bayes(refines = "linear_stiffness", both_signs = "v"), Documentation(info = "<html>
<p>The model of Bouc and Wen with the exponent 1: a joint, a wire rope, rubber or steel that yields. In Wen's terms <code>k_h</code> is A, and
<code>1 / x_h</code> and <code>s / x_h</code> are his beta and gamma. With <code>s = 0</code> it is Dahl's friction, below -1 it stiffens on the way out.</p>
<p>Source: R. Bouc, Forced vibration of mechanical systems with hysteresis (1967); Y.-K. Wen, Method for random vibration of hysteretic systems,
J. Eng. Mech. Div. ASCE 102 (1976), 249-263.</p>
</html>"));
end HystereticSpring;
