within Aero.Effects;
model AmplifierDeadzone "An amplifier that does not answer small voltages"
  extends Interfaces.ElectricalEffect;
  parameter Real V_dz(unit = "V", min = 0, max = 6, nominal = 0.5) = 0 "Half width of the amplifier's dead zone";
  parameter Real v_smooth(unit = "V", min = 1e-6) = 0.01 "Width of the rounding at its ends";
protected
  Real v(unit = "V") "Voltage that enters";
equation
  v = p.v - r.v;
  p.i + n.i = 0;
  r.i = 0;
  n.v - r.v = v + 0.5 * (sqrt((v - V_dz) ^ 2 + v_smooth ^ 2) - sqrt((v + V_dz) ^ 2 + v_smooth ^ 2));
  annotation (
    Documentation(info = "<html>
<p>Below <code>V_dz</code> nothing leaves the amplifier, above it <code>V_dz</code> is missing: <code>sign(v) max(|v| - V_dz, 0)</code>, with corners rounded
by a hyperbola of width <code>v_smooth</code>.</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-45, -25}, {-15, 0}, {15, 0}, {45, 25}}, color = {60, 60, 60})}));
end AmplifierDeadzone;
