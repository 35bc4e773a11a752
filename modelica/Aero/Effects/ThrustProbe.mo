within Aero.Effects;
model ThrustProbe "Unknown force added to the thrust"
  extends Interfaces.ThrustEffect;
  input Real u(unit = "N") "Signal, positive where it pitches the body up";
equation
  propeller.v = frame.v;
  -frame.f = propeller.f + orientation * u;
  annotation (
    Documentation(info = "<html>
<p>A port that carries an unknown signal, for finding out what acts there. With two thrusters the signal acts on both alike.</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Text(extent = {{-50, 30}, {50, -30}}, textString = "u")}));
end ThrustProbe;
