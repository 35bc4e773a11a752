within Laws.Readings;
model Delay "A reading that comes late"
  extends Laws.Interfaces.ReadingLaw;
  parameter Real T_d(min = 0, max = 10 * t_n, nominal = 0.1 * t_n) = 0 "Delay";
  Real z(nominal = u_n) "Quantity after four lags";
  Real w(start = 0, fixed = true, nominal = 6 * u_n) "Rate of change of z in units of its time";
  Real r(start = 0, fixed = true, nominal = 40 * u_n) "That of w";
  Real s(start = 0, fixed = true, nominal = 260 * u_n) "That of r";
protected
  final parameter Real T_min = 2e-3 * t_n "Delay below which the shape of the approximation is kept";
  parameter Real T = if T_d > 0 then (T_d ^ 4 + T_min ^ 4) ^ 0.25 else 1e6 * t_n "Delay in use; without one nothing moves";
initial equation
  z = u;
equation
  T * der(z) = w;
  T * der(w) = r;
  T * der(r) = s;
  T * der(s) = 1680 * (u - z) - 840 * w - 180 * r - 20 * s;
  y = u - T_d / T * (w + s / 42);
  annotation (__aero_bayes(memory = "delay"), Documentation(info = "<html>
<p><code>y(t) = u(t - T_d)</code> by the Pad&eacute; approximation of fourth order, from its steady state: <code>Laws.Outputs.Delay</code> without the rate of
<code>u</code>. Of a state a search reads what it was before the delay, as there.</p>
<p>Source: G. A. Baker, P. Graves-Morris, Pad&eacute; Approximants (Cambridge, 1996), sec. 1.2.</p>
</html>"));
end Delay;
