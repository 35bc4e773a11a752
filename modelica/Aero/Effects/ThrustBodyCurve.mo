within Aero.Effects;
model ThrustBodyCurve "Share of the thrust lost that is a curve over the body's motion"
  extends Interfaces.ThrustEffect;
  parameter Real x_min = -1 "First knot";
  parameter Real x_max = 1 "Last knot";
  parameter Real c[:] = {0, 0, 0} "Values at equally spaced knots";
  input Real x "Quantity of the body";
equation
  propeller.v = frame.v;
  propeller.f + frame.f = propeller.f * Functions.smoothTable(x, x_min, x_max, c);
  annotation (
    Documentation(info = "<html>
<p>A learned shape: share of the thrust that is lost over a quantity <code>x</code> of the body, through the values <code>c</code> at equally spaced knots and straight beyond the outer ones.</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-45, -20}, {-20, 15}, {10, -5}, {45, 20}}, color = {60, 60, 60}, smooth = Smooth.Bezier)}));
end ThrustBodyCurve;
