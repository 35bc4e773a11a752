within Aero.Effects;
model GravityOffset "A centre of mass beside the pivot"
  extends Interfaces.BodyEffect;
  parameter Real tau_g(unit = "N.m", min = -0.05, max = 0.05, nominal = 0.001) = 0 "Torque of a centre of mass beside the pivot, at zero pitch";
equation
  flange.tau = -tau_g * cos(theta);
  annotation (
    Documentation(info = "<html>
<p>A centre of mass in front of or behind the pivot gives the torque <code>tau_g cos(theta)</code>.</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-45, -15}, {45, 25}}, color = {60, 60, 60})}));
end GravityOffset;
