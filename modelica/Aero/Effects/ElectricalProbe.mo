within Aero.Effects;
model ElectricalProbe "Unknown voltage added at the motor"
  extends Interfaces.ElectricalEffect;
  input Real u(unit = "V") "Signal, positive where it pitches the body up";
equation
  p.i + n.i = 0;
  r.i = 0;
  n.v = p.v + orientation * u;
  annotation (
    Documentation(info = "<html>
<p>A port that carries an unknown signal, for finding out what acts there. With two thrusters the signal acts on both alike.</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Text(extent = {{-50, 30}, {50, -30}}, textString = "u")}));
end ElectricalProbe;
