within Laws.Inputs;
model RateLimit "An actuator that changes only so fast"
  extends Laws.Interfaces.InputLaw;
  parameter Real r(min = 0, max = 100 * t_n / (w_n * u_n), nominal = t_n / (w_n * u_n)) = 0 "Inverse of the largest rate of change";
  parameter Real start_z(min = -10 * u_n, max = 10 * u_n, nominal = u_n) = 0 "Where it is at the start, beyond the input there";
  Real z(nominal = u_n) "Input as a tracker of limited rate follows it";
protected
  parameter Real T = if r > 0 then 1e-4 * t_n else 1e6 * t_n "Time constant of the tracker; without a limit nothing moves";
  Real e "How far the tracker goes in that time";
initial equation
  z = u + start_z;
equation
  e = noEvent(if r * (u - z) > T then T / r elseif r * (z - u) > T then -T / r else u - z);
  T * der(z) = e;
  y = z + e;
  annotation (__aero_bayes(threshold = "r", memory = "rate_limit"), Documentation(info = "<html>
<p>The output follows the input at no more than <code>1 / r</code> a second, so that zero means no limit. It is where a tracker
of limited rate goes next, which is the input itself where the limit is not reached. Before the start the input was what it is there, or <code>start_z</code> more: a recording may begin in motion.</p>
<p>Source: L. Rundqwist, K. Stahl-Gunnarsson, Phase compensation of rate limiters in unstable aircraft, IEEE CCA (1996).</p>
</html>"));
end RateLimit;
