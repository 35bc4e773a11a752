within Laws.Inputs;
model SaturationBySide "An actuator whose output is limited differently on either side"
  extends Laws.Interfaces.InputLaw;
  parameter Real s(min = 0, max = 10 / u_n, nominal = 1.25 / u_n) = 0 "Inverse of the limit, mean of both sides";
  parameter Real a(min = -1.2, max = 1.2, nominal = 0.2) = 0 "Share by which the inverse is more for positive inputs and less for negative ones";
protected
  final parameter Real knee = 1e-3 "Width of the rounding at the limit, relative to it";
  Real s_u "Inverse of the limit on the input's side";
equation
  s_u = s * (1 + a * tanh(u / (0.01 * u_n)));
  y = u * (2 * sqrt(1 + knee ^ 2) / (sqrt((1 + s_u * u) ^ 2 + knee ^ 2) + sqrt((1 - s_u * u) ^ 2 + knee ^ 2)));
  annotation (__aero_bayes(refines = "saturation", both_signs = "u"),
    Documentation(info = "<html>
<p>The output ends at <code>1 / (s (1 + a))</code> above and at <code>-1 / (s (1 - a))</code> below; with <code>a = 1</code> nothing limits it below, as
behind a diode. The side changes where no limit is near.</p>
<p>Source: G. Tao, P. V. Kokotovic, Adaptive Control of Systems with Actuator and Sensor Nonlinearities (Wiley, 1996), ch. 1.</p>
</html>"));
end SaturationBySide;
