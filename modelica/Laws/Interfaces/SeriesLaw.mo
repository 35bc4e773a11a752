within Laws.Interfaces;
partial model SeriesLaw "Voltage drop in series with a current"
  parameter Real v_n = 1 "Typical size of the voltage";
  parameter Real i_n = 1 "Typical size of the current";
  parameter Real t_n = 1 "Typical time of the port's signals";
  input Real i "Current";
  output Real v "Voltage drop in the direction of the current";
  annotation (Documentation(info = "<html>
<p>Extend it with one equation for <code>v</code>, which is zero where the first parameter has its default.</p>
</html>"));
end SeriesLaw;
