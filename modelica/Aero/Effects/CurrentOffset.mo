within Aero.Effects;
model CurrentOffset "A current reading that is off by a constant"
  extends Interfaces.Sensor;
  parameter Real b_i(unit = "A", min = -1, max = 1, nominal = 0.01) = 0 "Offset of the current reading";
equation
  y = u + b_i;
  annotation (
    Documentation(info = "<html>
<p>A zero that was not set.</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-45, -15}, {45, 25}}, color = {60, 60, 60})}));
end CurrentOffset;
