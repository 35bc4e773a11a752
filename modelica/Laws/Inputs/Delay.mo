within Laws.Inputs;
model Delay "An actuator that answers after a delay"
  extends Laws.Interfaces.InputLaw;
  parameter Real T_d(min = 0, max = 10 * t_n, nominal = 0.1 * t_n) = 0 "Delay";
  Real z(nominal = u_n) "Input after four lags";
  Real w(start = 0, fixed = true, nominal = u_n) "Rate of change of z in units of its time";
  Real r(start = 0, fixed = true, nominal = 6 * u_n) "That of w";
  Real s(start = 0, fixed = true, nominal = 40 * u_n) "That of r";
protected
  final parameter Real T_min = 2e-3 * t_n "Delay below which the shape of the approximation is kept";
  parameter Real T = if T_d > 0 then (T_d ^ 4 + T_min ^ 4) ^ 0.25 else 1e6 * t_n "Delay in use; without one nothing moves";
initial equation
  z = u;
equation
  T * der(z) = w;
  T * der(w) = r;
  T * der(r) = s;
  T * der(s) = 840 * (u - z) - 480 * w - 120 * r - 16 * s;
  y = u - T_d / T * (u - z + 3 * w / 7 - r / 14 + s / 210);
  annotation (__aero_bayes(delay = "T_d"), Documentation(info = "<html>
<p><code>y(t) = u(t - T_d)</code> by the Pad&eacute; approximation <code>(1 - 3 T s / 7 + (T s)^2 / 14 - (T s)^3 / 210) / (1 + 4 T s / 7 + (T s)^2 / 7 + 2 (T s)^3 / 105 +
(T s)^4 / 840)</code>, whose output has no jump. For an input of angular frequency <code>a</code> the error is <code>(a T_d)^8 / 1411200</code> of its size: it
carries a delay as well as that of a reading does. Below <code>T_min</code> it is taken to first order in <code>T_d</code>. Before the start the input was what it is there.</p>
<p>The loop fits a delay of a recorded input exactly: it moves the recorded input, and solves none of these equations.</p>
<p>Source: G. A. Baker, P. Graves-Morris, Pad&eacute; Approximants (Cambridge, 1996), sec. 1.2.</p>
</html>"));
end Delay;
