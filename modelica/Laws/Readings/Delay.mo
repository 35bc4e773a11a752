within Laws.Readings;
model Delay "Reading that comes late"
  extends Laws.Interfaces.ReadingLaw;
  parameter Real T_d(min = 0, max = 10 * t_n, nominal = 0.1 * t_n) = 0 "Delay";
  Real z(nominal = u_n) "Quantity after two lags";
  Real w(start = 0, fixed = true, nominal = u_n) "Rate of change of z in units of its time";
protected
  final parameter Real T_min = 1e-2 * t_n "Delay below which the shape of the approximation is kept";
  parameter Real T = sqrt(T_d ^ 2 + T_min ^ 2) "Delay in use";
initial equation
  z = u;
equation
  T * der(z) = w;
  T * der(w) = 12 * (u - z) - 6 * w;
  y = u - T_d / T * w;
  annotation (Documentation(info = "<html>
<p><code>y(t) = u(t - T_d)</code> by the Pad&eacute; approximation of second order, from its steady state: <code>Laws.Outputs.Delay</code> without the rate of
<code>u</code>.</p>
<p>Source: G. A. Baker, P. Graves-Morris, Pad&eacute; Approximants (Cambridge, 1996), sec. 1.2.</p>
</html>"));
end Delay;
