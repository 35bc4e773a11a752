within Laws.Motion;
model AttachedMass "A mass or inertia that hangs on a spring and a damper"
  extends Laws.Interfaces.MotionLaw;
  parameter Real m_a(min = 0, max = 100 * f_n * t_n / v_n, nominal = 0.3 * f_n * t_n / v_n) = 0 "Attached mass or inertia";
  parameter Real w_a(min = 0.03 / t_n, max = 30 / t_n, nominal = 1 / t_n) = 1 / t_n "Angular frequency at which it swings while the body is held";
  parameter Real d_a(min = 1e-3, max = 2, nominal = 0.1) = 0.1 "Its damping ratio";
  Real v_a(nominal = v_n) "Speed of the attached mass";
  Real x_a(start = 0, fixed = true, nominal = x_n) "Displacement by which the body is ahead of it";
initial equation
  v_a = v;
equation
  der(x_a) = v - v_a;
  der(v_a) = w_a ^ 2 * x_a + 2 * d_a * w_a * (v - v_a);
  f = m_a * (w_a ^ 2 * x_a + 2 * d_a * w_a * (v - v_a));
  annotation (__aero_bayes(absolute = "v"), Documentation(info = "<html>
<p>The spring has the stiffness <code>m_a w_a^2</code>, the damper <code>2 d_a m_a w_a</code>: a load on a soft shaft or belt, a payload that swings, a machine on its
rubber feet, an absorber. It starts at the speed of the body with the spring at rest.</p>
<p>Source: J. P. Den Hartog, Mechanical Vibrations (McGraw-Hill, 1956), ch. 3.</p>
</html>"));
end AttachedMass;
