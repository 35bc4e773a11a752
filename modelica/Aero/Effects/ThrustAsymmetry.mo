within Aero.Effects;
model ThrustAsymmetry "Thrust that differs between pitching up and down"
  extends Laws.Interfaces.InputLaw;
  parameter Real a_f(min = -0.9, max = 0.9, nominal = 0.1) = 0 "Relative gain of thrust pitching up, loss pitching down";
protected
  final parameter Real u_smooth = 1e-3 * u_n "Thrust over which the sign changes";
equation
  y = u * (1 + a_f * tanh(u / u_smooth));
  annotation (
    Documentation(info = "<html>
<p>The frame stands in the wake on one side only: <code>F (1 + a_f sign(F))</code>, with <code>F</code> counted in the direction that pitches the
body up and the step rounded to a hyperbolic tangent.</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-45, -10}, {0, 0}, {45, 25}}, color = {60, 60, 60})}));
end ThrustAsymmetry;
