within Aero.Effects;
model GravityOffset "A centre of mass beside the pivot"
  extends Laws.Interfaces.MotionLaw(x(unit = "rad"));
  parameter Real tau_g(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Torque of a centre of mass beside the pivot, at zero pitch";
equation
  f = -tau_g * cos(x);
  annotation (
    Documentation(info = "<html>
<p>A centre of mass in front of or behind the pivot gives the torque <code>tau_g cos(theta)</code>.</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-45, -15}, {45, 25}}, color = {60, 60, 60})}));
end GravityOffset;
