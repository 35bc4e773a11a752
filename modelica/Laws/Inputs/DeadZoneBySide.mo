within Laws.Inputs;
model DeadZoneBySide "An actuator that does not answer small inputs, differently on either side"
  extends Laws.Interfaces.InputLaw;
  parameter Real u_d(min = 0, max = 0.9 * u_n, nominal = 0.1 * u_n) = 0 "Half width of the dead zone";
  parameter Real a(min = -1.2, max = 1.2, nominal = 0.2) = 0 "Share by which it is wider above and narrower below";
protected
  final parameter Real u_smooth = 1e-3 * u_n "Width of the rounding at the corners";
  Real v "Distance of the input from the middle";
equation
  v = u - a * u_d;
  y = v + 0.5 * (sqrt((v - u_d) ^ 2 + u_smooth ^ 2) - sqrt((v + u_d) ^ 2 + u_smooth ^ 2));
  annotation (__aero_bayes(refines = "dead_zone", both_signs = "u"),
    Documentation(info = "<html>
<p>From <code>-(1 - a) u_d</code> to <code>(1 + a) u_d</code> nothing leaves the actuator, beyond it what the input is past the end: a valve whose edges overlap
the ports by different widths.</p>
<p>Source: G. Tao, P. V. Kokotovic, Adaptive Control of Systems with Actuator and Sensor Nonlinearities (Wiley, 1996), ch. 2.</p>
</html>"));
end DeadZoneBySide;
