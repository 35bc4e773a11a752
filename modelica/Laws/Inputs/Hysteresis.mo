within Laws.Inputs;
model Hysteresis "An actuator with play, or a part of it"
  extends Laws.Interfaces.InputLaw;
  parameter Real s_p(min = 0, max = 1, nominal = 0.5) = 0 "Share of the input that goes through the play";
  parameter Real u_p(min = 0.02 * u_n, max = u_n, nominal = 0.3 * u_n) = 0.3 * u_n "Half width of the play";
  parameter Real start_z(min = -10 * u_n, max = 10 * u_n, nominal = u_n) = 0 "Where it is at the start, beyond the input there";
  Real z(nominal = u_n) "Where the play has been pushed to";
protected
  parameter Real T = if s_p > 0 then 5e-3 * t_n else 1e6 * t_n "Time in which the play is pushed; without a share nothing moves";
  final parameter Real u_smooth = 1e-4 * u_n "Width of the rounding at the ends of the play";
  Real e "How far the input has gone beyond the play's end";
initial equation
  z = u + start_z;
equation
  e = noEvent(if u - z > u_p then (u - z - u_p) ^ 2 / (u - z - u_p + u_smooth) elseif z - u > u_p then -(z - u - u_p) ^ 2 / (z - u - u_p + u_smooth) else 0);
  T * der(z) = e;
  y = u - s_p * (u - z - e);
  annotation (__aero_bayes(memory = "play"), Documentation(info = "<html>
<p>A share <code>s_p</code> of the input is pushed through a play: it stands still until the input has gone <code>u_p</code> past it, and is pushed along from then
on. All of it is backlash as in a linkage or a valve that sticks; a part of it hysteresis as in a piezo or a magnet. What has gone beyond the play's end counts at
once, before the play is there; within its ends nothing moves at all. It starts in the middle of the play, or <code>start_z</code> beside it: a recording may begin in motion.</p>
<p>Source: M. A. Krasnosel'skii, A. V. Pokrovskii, Systems with Hysteresis (Springer, 1989), part 1; G. Tao, P. V. Kokotovic, Adaptive Control of Systems with
Actuator and Sensor Nonlinearities (Wiley, 1996), ch. 2.</p>
</html>"));
end Hysteresis;
