within Aero.Effects;
model ElectricalCurve "Voltage drop that is a curve over the current"
  extends Interfaces.ElectricalEffect;
  parameter Real x_min = -1 "First knot";
  parameter Real x_max = 1 "Last knot";
  parameter Real c[:] = {0, 0, 0} "Values at equally spaced knots";
equation
  p.i + n.i = 0;
  r.i = 0;
  p.v - n.v = Functions.smoothTable(p.i, x_min, x_max, c);
  annotation (
    Documentation(info = "<html>
<p>A learned shape: voltage drop over the motor's current, through the values <code>c</code> at equally spaced knots and straight beyond the outer ones.</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-45, -20}, {-20, 15}, {10, -5}, {45, 20}}, color = {60, 60, 60}, smooth = Smooth.Bezier)}));
end ElectricalCurve;
