within Laws.Inputs;
model Delay "Actuator that answers after a delay"
  extends Laws.Interfaces.InputLaw;
  parameter Real T_d(min = 0, max = 10 * t_n, nominal = 0.1 * t_n) = 0 "Delay";
  Real z(nominal = u_n) "Input after six lags";
  Real w(start = 0, fixed = true, nominal = u_n) "Rate of change of z in units of its time";
  Real r(start = 0, fixed = true, nominal = u_n) "That of w";
  Real s(start = 0, fixed = true, nominal = u_n) "That of r";
  Real p(start = 0, fixed = true, nominal = u_n) "That of s";
  Real q(start = 0, fixed = true, nominal = u_n) "That of p";
protected
  final parameter Real T_min = 1e-2 * t_n "Delay below which the shape of the approximation is kept";
  parameter Real T = if T_d > 0 then sqrt(T_d ^ 2 + T_min ^ 2) else 1e6 * t_n "Delay in use; without one nothing moves";
initial equation
  z = u;
equation
  T * der(z) = w;
  T * der(w) = r;
  T * der(r) = s;
  T * der(s) = p;
  T * der(p) = q;
  T * der(q) = 332640 * (u - z) - 181440 * w - 45360 * r - 6720 * s - 630 * p - 36 * q;
  y = u - T_d / T * (u - z + 5 / 11 * w - r / 11 + s / 99 - p / 1584 + q / 55440);
  annotation (Documentation(info = "<html>
<p><code>y(t) = u(t - T_d)</code> by the Pad&eacute; approximation of orders five and six, whose output has no jump. For an input of angular frequency <code>a</code>
the error is <code>(a T_d)^12 / 2.2e11</code> of its size; a step is followed by ripple that is faster than <code>6 / T_d</code>. Below <code>T_min</code> it is taken to first order in <code>T_d</code>. Before the
start the input was what it is there.</p>
<p>Source: G. A. Baker, P. Graves-Morris, Pad&eacute; Approximants (Cambridge, 1996), sec. 1.2.</p>
</html>"));
end Delay;
