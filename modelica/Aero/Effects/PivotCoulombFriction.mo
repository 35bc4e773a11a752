within Aero.Effects;
model PivotCoulombFriction "Dry friction at the pivot"
  extends Interfaces.BodyEffect;
  parameter Real tau_c(unit = "N.m", min = 0, max = 0.05, nominal = 0.001) = 0 "Dry friction torque at the pivot";
  parameter Real w_smooth(unit = "rad/s", min = 1e-7) = 2e-5 "Pitch rate over which the torque changes its sign";
equation
  flange.tau = tau_c * tanh(flange.w / w_smooth);
  annotation (
    Documentation(info = "<html>
<p>The bearing brakes with <code>tau_c sign(theta')</code>, here with the step rounded to <code>tanh(theta' / w_smooth)</code>. A body that sticks creeps by
less than <code>w_smooth</code> times the time.</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-45, -25}, {-5, -25}, {5, 25}, {45, 25}}, color = {60, 60, 60})}));
end PivotCoulombFriction;
