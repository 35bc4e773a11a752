within Laws.Motion;
model Unbalance "A weight out of the axis of a rotation"
  extends Laws.Interfaces.MotionLaw(x(unit = "rad"));
  parameter Real M_g(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Greatest torque of the weight";
  parameter Real phi_g(min = -1.8, max = 1.8, nominal = 0.6, unit = "rad") = 0 "How far past its place of rest the angle's zero is";
equation
  f = M_g * sin(x + phi_g);
  annotation (__aero_bayes(refines = "linear_stiffness"),
    Documentation(info = "<html>
<p><code>M_g sin(x + phi_g)</code>: an arm or a wheel whose centre of mass is not on the axis, which does not stand upright; the weight times its lever is
<code>M_g</code>, negative where the angle counts from the top.</p>
<p>Source: H. Goldstein, Classical Mechanics (Addison-Wesley, 1980), ch. 1: generalised forces; the plane pendulum.</p>
</html>"));
end Unbalance;
