within Aero.Effects;
model PitchDelay "A reading that comes late"
  extends Interfaces.Sensor;
  parameter Real T_d(unit = "s", min = 0, max = 0.5, nominal = 0.03) = 0 "Delay of the pitch reading";
  parameter Real T_min(unit = "s", min = 1e-6) = 2e-3 "Delay below which the shape of the approximation is kept";
  Real q(start = 0, fixed = true, nominal = 0.1) "Filtered rate of change";
  Real dq(start = 0, fixed = true, nominal = 10) "Its rate of change";
protected
  parameter Real T(unit = "s") = max(T_d, T_min);
equation
  der(q) = dq;
  T * T * der(dq) = 12 * (du - q) - 6 * T * dq;
  y = u - T_d * q;
  annotation (
    Documentation(info = "<html>
<p><code>y(t) = u(t - T_d)</code> by the Pad&eacute; approximation of second order: <code>y = u - T_d q</code>, where <code>q</code> is the rate of change passed
through <code>1 / (1 + T_d s / 2 + T_d^2 s^2 / 12)</code>. For a motion of angular frequency <code>a</code> the error is
<code>(a T_d)^5 / 720</code> of its size.</p>
<p>Source: G. A. Baker, P. Graves-Morris, Pad&eacute; Approximants (Cambridge, 1996), sec. 1.2: the approximation of second order.</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-45, -20}, {-10, -20}, {0, 20}, {45, 20}}, color = {60, 60, 60})}));
end PitchDelay;
