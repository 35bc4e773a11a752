within Laws.Inputs;
model Delay "Actuator that answers after a delay"
  extends Laws.Interfaces.InputLaw;
  parameter Real T_d(min = 0, max = 10 * t_n, nominal = 0.1 * t_n) = 0 "Delay";
  Real z(nominal = u_n) "Input after two lags";
  Real w(start = 0, fixed = true, nominal = u_n) "Rate of change of z in units of its time";
protected
  final parameter Real T_min = 2e-2 * t_n "Delay below which the shape of the approximation is kept";
  parameter Real T = if T_d > 0 then (T_d ^ 4 + T_min ^ 4) ^ 0.25 else 1e6 * t_n "Delay in use; without one nothing moves";
initial equation
  z = u;
equation
  T * der(z) = w;
  T * der(w) = 6 * (u - z) - 4 * w;
  y = u - T_d / T * (u - z + w / 3);
  annotation (Documentation(info = "<html>
<p><code>y(t) = u(t - T_d)</code> by the Pad&eacute; approximation <code>(1 - T s / 3) / (1 + 2 T s / 3 + T^2 s^2 / 6)</code>, whose output has no jump. For an input
of angular frequency <code>a</code> the error is <code>(a T_d)^4 / 72</code> of its size. Below <code>T_min</code> it is taken to first order in <code>T_d</code>. Before the
start the input was what it is there.</p>
<p>Source: G. A. Baker, P. Graves-Morris, Pad&eacute; Approximants (Cambridge, 1996), sec. 1.2.</p>
</html>"));
end Delay;
