within Aero.Effects;
model RotorCoulombFriction "Dry friction of the rotor"
  extends Interfaces.RotorEffect;
  parameter Real tau_r(unit = "N.m", min = 0, max = 0.02, nominal = 0.001) = 0 "Dry friction torque of a rotor";
  parameter Real w_smooth(unit = "rad/s", min = 1e-6) = 0.05 "Speed over which the torque changes its sign";
equation
  flange.tau = tau_r * tanh(flange.w / w_smooth);
  annotation (
    Documentation(info = "<html>
<p>Bearings and brushes brake with <code>tau_r sign(w)</code>, here with the step rounded to <code>tanh(w / w_smooth)</code>.</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-45, -25}, {-5, -25}, {5, 25}, {45, 25}}, color = {60, 60, 60})}));
end RotorCoulombFriction;
