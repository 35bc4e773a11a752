within Laws.Outputs;
model Delay "Reading that comes late"
  extends Laws.Interfaces.OutputLaw;
  parameter Real T_d(min = 0, max = 10 * t_n, nominal = 0.1 * t_n) = 0 "Delay";
  Real q(start = 0, fixed = true, nominal = u_n / t_n) "Filtered rate of change";
  Real p(start = 0, fixed = true, nominal = u_n / t_n) "Its rate of change in units of the delay";
  Real r(start = 0, fixed = true, nominal = u_n / t_n) "That of p";
  Real s(start = 0, fixed = true, nominal = u_n / t_n) "That of r";
  Real a(start = 0, fixed = true, nominal = u_n / t_n) "That of s";
  Real b(start = 0, fixed = true, nominal = u_n / t_n) "That of a";
protected
  final parameter Real T_min = 1e-2 * t_n "Delay below which the shape of the approximation is kept";
  parameter Real T = if T_d > 0 then sqrt(T_d ^ 2 + T_min ^ 2) else 1e6 * t_n "Delay in use; without one nothing moves";
equation
  T * der(q) = p;
  T * der(p) = r;
  T * der(r) = s;
  T * der(s) = a;
  T * der(a) = b;
  T * der(b) = 665280 * (der(u) - q) - 332640 * p - 75600 * r - 10080 * s - 840 * a - 42 * b;
  y = u - T_d * (q + r / 33 + a / 7920);
  annotation (Documentation(info = "<html>
<p><code>y(t) = u(t - T_d)</code> by the Pad&eacute; approximation of sixth order: <code>q</code> is the rate of change passed through
<code>1 / (1 + T s / 2 + 5 (T s)^2 / 44 + (T s)^3 / 66 + (T s)^4 / 792 + (T s)^5 / 15840 + (T s)^6 / 665280)</code>. For a motion of angular frequency <code>f</code> the error is
<code>(f T_d)^13 / 5.8e12</code> of its size.</p>
<p>Source: G. A. Baker, P. Graves-Morris, Pad&eacute; Approximants (Cambridge, 1996), sec. 1.2.</p>
</html>"));
end Delay;
