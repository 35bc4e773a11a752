within Aero.Effects;
model WindingHeating "An armature resistance that grows as the winding heats"
  extends Interfaces.ElectricalEffect;
  parameter Real r_h(unit = "Ohm/A2", min = 0, max = 1000, nominal = 20) = 0 "Added resistance of the warm winding";
  parameter Real T_h(unit = "s", min = 0.5, max = 500, nominal = 10) = 10 "Time constant of the winding's heating";
  Real h(unit = "A2", start = 0, fixed = true, nominal = 0.01) "Squared current as the winding's temperature follows it";
equation
  p.i + n.i = 0;
  r.i = 0;
  T_h * der(h) = p.i * p.i - h;
  p.v - n.v = r_h * h * p.i;
  annotation (
    Documentation(info = "<html>
<p>The heat <code>i^2 R</code> warms the winding with the time constant <code>T_h</code>; its resistance grows in proportion to the
temperature. The small growth of the heat with the added resistance is left out.</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-45, -25}, {-25, 5}, {0, 18}, {45, 22}}, color = {60, 60, 60})}));
end WindingHeating;
