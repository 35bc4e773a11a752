within Laws.Outputs;
model Offset "A reading that is off by a constant"
  extends Laws.Interfaces.OutputLaw;
  parameter Real b(min = -10 * u_n, max = 10 * u_n, nominal = 0.1 * u_n) = 0 "Offset of the reading";
equation
  y = u + b;
  annotation (Documentation(info = "<html>
<p>A bias of the instrument.</p>
<p>Source: JCGM 200:2012, International Vocabulary of Metrology, 4.20 (instrumental bias).</p>
</html>"));
end Offset;
