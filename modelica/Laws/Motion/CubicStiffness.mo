within Laws.Motion;
model CubicStiffness "Stiffness that changes with the displacement"
  extends Laws.Interfaces.MotionLaw;
  parameter Real k_3(min = -10 * f_n / x_n ^ 3, max = 10 * f_n / x_n ^ 3, nominal = 0.1 * f_n / x_n ^ 3) = 0 "Cubic stiffness";
equation
  f = k_3 * x ^ 3;
  annotation (Documentation(info = "<html>
<p>The first symmetric correction of a linear spring: hardening where positive, softening where negative.</p>
<p>Source: G. Duffing, Erzwungene Schwingungen bei ver&auml;nderlicher Eigenfrequenz (Vieweg, 1918).</p>
</html>"));
end CubicStiffness;
