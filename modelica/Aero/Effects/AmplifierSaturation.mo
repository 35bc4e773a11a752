within Aero.Effects;
model AmplifierSaturation "An amplifier whose voltage is limited"
  extends Interfaces.ElectricalEffect;
  parameter Real s_sat(unit = "1/V", min = 0, max = 0.5, nominal = 0.05) = 0 "Inverse of the amplifier's limit";
  parameter Real knee(unit = "1", min = 1e-6) = 1e-3 "Width of the rounding at the limit, relative to it";
protected
  Real v(unit = "V") "Voltage that enters";
equation
  v = p.v - r.v;
  p.i + n.i = 0;
  r.i = 0;
  n.v - r.v = v * (2 * sqrt(1 + knee ^ 2) / (sqrt((1 + s_sat * v) ^ 2 + knee ^ 2) + sqrt((1 - s_sat * v) ^ 2 + knee ^ 2)));
  annotation (
    Documentation(info = "<html>
<p>The voltage stays within <code>1 / s_sat</code> on both sides, with the corner rounded. The limit is given by its inverse, so
that zero means no limit.</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-45, -20}, {-20, -20}, {20, 20}, {45, 20}}, color = {60, 60, 60})}));
end AmplifierSaturation;
