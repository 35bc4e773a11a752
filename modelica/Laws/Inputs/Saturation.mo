within Laws.Inputs;
model Saturation "An actuator whose output is limited"
  extends Laws.Interfaces.InputLaw;
  parameter Real s(min = 0, max = 10 / u_n, nominal = 1.25 / u_n) = 0 "Inverse of the limit";
protected
  final parameter Real knee = 1e-3 "Width of the rounding at the limit, relative to it";
equation
  y = u * (2 * sqrt(1 + knee ^ 2) / (sqrt((1 + s * u) ^ 2 + knee ^ 2) + sqrt((1 - s * u) ^ 2 + knee ^ 2)));
  annotation (Documentation(info = "<html>
<p>The output stays within <code>1 / s</code> on both sides, the corner rounded. The limit is given by its inverse, so that zero means no limit. While
the limit is beyond the inputs that occur it cannot be felt: a search starts from <code>nominal</code>, not from zero.</p>
<p>Source: G. Tao, P. V. Kokotovic, Adaptive Control of Systems with Actuator and Sensor Nonlinearities (Wiley, 1996), ch. 1.</p>
</html>"));
end Saturation;
