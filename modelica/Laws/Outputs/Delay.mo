within Laws.Outputs;
model Delay "A reading that comes late"
  extends Laws.Interfaces.OutputLaw;
  parameter Real T_d(min = 0, max = 10 * t_n, nominal = 0.1 * t_n) = 0 "Delay";
  Real q(start = 0, fixed = true, nominal = u_n) "Filtered rate of change in units of its time";
  Real p(start = 0, fixed = true, nominal = 6 * u_n) "That of q";
  Real r(start = 0, fixed = true, nominal = 40 * u_n) "That of p";
  Real s(start = 0, fixed = true, nominal = 260 * u_n) "That of r";
protected
  final parameter Real T_min = 2e-3 * t_n "Delay below which the shape of the approximation is kept";
  parameter Real T = if T_d > 0 then (T_d ^ 4 + T_min ^ 4) ^ 0.25 else 1e6 * t_n "Delay in use; without one nothing moves";
equation
  T * der(q) = p;
  T * der(p) = r;
  T * der(r) = s;
  T * der(s) = 1680 * ((if T_d > 0 then T else 0) * der(u) - q) - 840 * p - 180 * r - 20 * s;
  y = u - T_d / T * (q + r / 42);
  annotation (__aero_bayes(memory = "delay"), Documentation(info = "<html>
<p><code>y(t) = u(t - T_d)</code> by the Pad&eacute; approximation of fourth order: <code>q / T</code> is the rate of change passed through
<code>1 / (1 + T s / 2 + 3 (T s)^2 / 28 + (T s)^3 / 84 + (T s)^4 / 1680)</code>. For a motion of angular frequency <code>a</code> the error is
<code>(a T_d)^9 / 25401600</code> of its size. Before the start nothing moved.</p>
<p>Where the reading is a state of the model, a search reads the state itself before the delay, and solves none of these equations.</p>
<p>Source: G. A. Baker, P. Graves-Morris, Pad&eacute; Approximants (Cambridge, 1996), sec. 1.2.</p>
</html>"));
end Delay;
