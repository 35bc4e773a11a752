within Laws.Outputs;
model Gain "A reading that is too large or too small by a factor"
  extends Laws.Interfaces.OutputLaw;
  parameter Real g(min = -0.95, max = 9, nominal = 0.1) = 0 "Relative error of the gain";
equation
  y = (1 + g) * u;
  annotation (Documentation(info = "<html>
<p>An error of calibration.</p>
<p>Source: JCGM 200:2012, International Vocabulary of Metrology, 4.12 (sensitivity).</p>
</html>"));
end Gain;
