within Laws.Outputs;
model SaturationBySide "A reading that ends at the instrument's range, differently on either side"
  extends Laws.Interfaces.OutputLaw;
  parameter Real s(min = 0, max = 10 / u_n, nominal = 1.25 / u_n) = 0 "Inverse of the largest reading, mean of both sides";
  parameter Real a(min = -1.2, max = 1.2, nominal = 0.2) = 0 "Share by which the inverse is more for positive readings and less for negative ones";
protected
  final parameter Real knee = 1e-3 "Width of the rounding at the end of the range, relative to it";
  Real s_u "Inverse of the largest reading on the quantity's side";
equation
  s_u = s * (1 + a * tanh(u / (0.01 * u_n)));
  y = u * (2 * sqrt(1 + knee ^ 2) / (sqrt((1 + s_u * u) ^ 2 + knee ^ 2) + sqrt((1 - s_u * u) ^ 2 + knee ^ 2)));
  annotation (__aero_bayes(refines = "saturation", both_signs = "u"),
    Documentation(info = "<html>
<p>The reading ends at <code>1 / (s (1 + a))</code> above and at <code>-1 / (s (1 - a))</code> below; with <code>a = 1</code> at nothing below.</p>
<p>Source: JCGM 200:2012, International Vocabulary of Metrology, 4.7 (measuring interval).</p>
</html>"));
end SaturationBySide;
