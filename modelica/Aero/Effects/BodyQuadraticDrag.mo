within Aero.Effects;
model BodyQuadraticDrag "Air drag of the body"
  extends Interfaces.BodyEffect;
  parameter Real c_b(unit = "N.m.s2/rad2", min = 0, max = 0.5, nominal = 0.005) = 0 "Air drag of the body";
equation
  flange.tau = c_b * flange.w * abs(flange.w);
  annotation (
    Documentation(info = "<html>
<p>A torque <code>c_b theta' |theta'|</code>, always against the motion.</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-45, -28}, {-25, -5}, {0, 0}, {25, 5}, {45, 28}}, color = {60, 60, 60})}));
end BodyQuadraticDrag;
