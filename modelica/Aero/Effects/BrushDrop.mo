within Aero.Effects;
model BrushDrop "A voltage drop of the brush contacts"
  extends Interfaces.ElectricalEffect;
  parameter Real V_b(unit = "V", min = 0, max = 6, nominal = 0.5) = 0 "Voltage drop of the brush contacts";
  parameter Real i_smooth(unit = "A", min = 1e-8) = 1e-5 "Current over which the drop changes its sign";
equation
  p.i + n.i = 0;
  r.i = 0;
  p.v - n.v = V_b * tanh(p.i / i_smooth);
  annotation (
    Documentation(info = "<html>
<p>Carbon brushes lose a voltage that hardly depends on the current: <code>V_b sign(i)</code>, here with the step rounded to
<code>tanh(i / i_smooth)</code>.</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-45, -25}, {-5, -25}, {5, 25}, {45, 25}}, color = {60, 60, 60})}));
end BrushDrop;
