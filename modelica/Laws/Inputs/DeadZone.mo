within Laws.Inputs;
model DeadZone "An actuator that does not answer small inputs"
  extends Laws.Interfaces.InputLaw;
  parameter Real u_d(min = 0, max = 0.9 * u_n, nominal = 0.1 * u_n) = 0 "Half width of the dead zone";
protected
  final parameter Real u_smooth = 1e-3 * u_n "Width of the rounding at the corners";
equation
  y = u + 0.5 * (sqrt((u - u_d) ^ 2 + u_smooth ^ 2) - sqrt((u + u_d) ^ 2 + u_smooth ^ 2));
  annotation (Documentation(info = "<html>
<p>Below <code>u_d</code> nothing leaves the actuator, above it <code>u_d</code> is missing: <code>sign(u) max(|u| - u_d, 0)</code>, the corners rounded by a
hyperbola.</p>
<p>Source: G. Tao, P. V. Kokotovic, Adaptive Control of Systems with Actuator and Sensor Nonlinearities (Wiley, 1996), ch. 2.</p>
</html>"));
end DeadZone;
