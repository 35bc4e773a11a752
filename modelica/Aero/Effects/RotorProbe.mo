within Aero.Effects;
model RotorProbe "Unknown torque added at the rotor"
  extends Interfaces.RotorEffect;
  input Real u(unit = "N.m") "Signal, positive where it pitches the body up";
equation
  flange.tau = -orientation * u;
  annotation (
    Documentation(info = "<html>
<p>A port that carries an unknown signal, for finding out what acts there. With two thrusters the signal acts on both alike.</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Text(extent = {{-50, 30}, {50, -30}}, textString = "u")}));
end RotorProbe;
