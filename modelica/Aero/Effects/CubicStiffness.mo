within Aero.Effects;
model CubicStiffness "Stiffness that changes with the pitch angle"
  extends Interfaces.BodyEffect;
  parameter Real k_3(unit = "N.m/rad3", min = -0.5, max = 0.5, nominal = 0.005) = 0 "Cubic part of the body's stiffness";
equation
  flange.tau = k_3 * theta ^ 3;
  annotation (
    Documentation(info = "<html>
<p>The first symmetric correction of a linear spring, <code>k_3 theta^3</code>; <code>-K_sp / 6</code> is that of a pendulum.</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-45, -28}, {-25, -5}, {0, 0}, {25, 5}, {45, 28}}, color = {60, 60, 60})}));
end CubicStiffness;
