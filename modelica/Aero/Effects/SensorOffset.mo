within Aero.Effects;
model SensorOffset "Reading that is off by a constant"
  extends Interfaces.Sensor;
  parameter Real b = 0 "Offset, in the unit of the reading";
equation
  y = u + b;
  annotation (
    Documentation(info = "<html>
<p>A zero that was not set.</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-45, -15}, {45, 25}}, color = {60, 60, 60})}));
end SensorOffset;
