within Aero.Effects;
model SupplyResistance "A resistance of supply and leads"
  extends Interfaces.ElectricalEffect;
  parameter Real R_s(unit = "Ohm", min = 0, max = 20, nominal = 1) = 0 "Resistance of supply and leads";
equation
  p.i + n.i = 0;
  r.i = 0;
  p.v - n.v = R_s * p.i;
  annotation (
    Documentation(info = "<html>
<p>The voltage at the motor falls by <code>R_s i</code>. In one channel it cannot be told from the armature's resistance.</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-45, -25}, {45, 25}}, color = {60, 60, 60})}));
end SupplyResistance;
