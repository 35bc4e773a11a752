within Laws.Outputs;
model Saturation "A reading that ends at the instrument's range"
  extends Laws.Interfaces.OutputLaw;
  parameter Real s(min = 0, max = 10 / u_n, nominal = 1.25 / u_n) = 0 "Inverse of the largest reading";
protected
  final parameter Real knee = 1e-3 "Width of the rounding at the end of the range, relative to it";
equation
  y = u * (2 * sqrt(1 + knee ^ 2) / (sqrt((1 + s * u) ^ 2 + knee ^ 2) + sqrt((1 - s * u) ^ 2 + knee ^ 2)));
  annotation (Documentation(info = "<html>
<p>The reading stays within <code>1 / s</code> on both sides, the corner rounded: an amplifier or a converter that is full.</p>
<p>Source: JCGM 200:2012, International Vocabulary of Metrology, 4.7 (measuring interval).</p>
</html>"));
end Saturation;
