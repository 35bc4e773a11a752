within Laws.Electrical;
model SeriesResistance "A resistance in series"
  extends Laws.Interfaces.SeriesLaw;
  parameter Real R_s(min = 0, max = 10 * v_n / i_n, nominal = 0.1 * v_n / i_n) = 0 "Resistance";
equation
  v = R_s * i;
  annotation (Documentation(info = "<html>
<p>Leads, supply, a sensing resistor.</p>
<p>Source: G. S. Ohm, Die galvanische Kette, mathematisch bearbeitet (1827).</p>
</html>"));
end SeriesResistance;
