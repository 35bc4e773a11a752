within Aero.Effects;
model PitchOffset "A pitch reading that is off by a constant"
  extends Interfaces.Sensor;
  parameter Real b_th(unit = "rad", min = -0.5, max = 0.5, nominal = 0.01) = 0 "Offset of the pitch reading";
equation
  y = u + b_th;
  annotation (
    Documentation(info = "<html>
<p>A zero that was not set.</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-45, -15}, {45, 25}}, color = {60, 60, 60})}));
end PitchOffset;
