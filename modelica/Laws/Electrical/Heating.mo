within Laws.Electrical;
model Heating "A resistance that grows as the winding heats"
  extends Laws.Interfaces.SeriesLaw;
  parameter Real r_h(min = 0, max = 10 * v_n / i_n ^ 3, nominal = 0.1 * v_n / i_n ^ 3) = 0 "Added resistance for each square ampere after a long time";
  parameter Real T_h(min = 0.1 * t_n, max = 1000 * t_n, nominal = 10 * t_n) = 10 * t_n "Thermal time constant";
  Real s(start = 0, fixed = true, nominal = i_n ^ 2) "Squared current as the temperature follows it";
equation
  T_h * der(s) = i ^ 2 - s;
  v = r_h * s * i;
  annotation (Documentation(info = "<html>
<p>The heat <code>i^2 R</code> warms the conductor with the time constant <code>T_h</code>; its resistance grows in proportion to the temperature. The small
growth of the heat with the added resistance is left out. It starts cold.</p>
<p>Source: IEC 60034-1, Rotating electrical machines, clause 8 (temperature by resistance).</p>
</html>"));
end Heating;
