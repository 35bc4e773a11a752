within Laws.Electrical;
model Polarisation "A voltage that builds up over a resistor and a capacitor in parallel"
  extends Laws.Interfaces.SeriesLaw;
  parameter Real R_1(min = 0, max = 10 * v_n / i_n, nominal = 0.1 * v_n / i_n) = 0 "Resistance of the pair";
  parameter Real T_1(min = 0.1 * t_n, max = 1000 * t_n, nominal = 3 * t_n) = 3 * t_n "Time constant of the pair, its resistance times its capacitance";
  parameter Real start_i_1(min = -10 * i_n, max = 10 * i_n, nominal = i_n) = 0 "Current through the resistance at the start, beyond the current";
  Real i_1(nominal = i_n) "Current through the resistance; the rest charges the capacitance";
initial equation
  i_1 = i + start_i_1;
equation
  T_1 * der(i_1) = i - i_1;
  v = R_1 * i_1;
  annotation (Documentation(info = "<html>
<p>A capacitance <code>C_1 = T_1 / R_1</code> beside the resistance: <code>C_1 dv/dt = i - v / R_1</code>. The double layer of an electrode, diffusion in a cell,
a filter in a lead. The current before the start was what it is there, or <code>start_i_1</code> more.</p>
<p>Source: G. L. Plett, Battery Management Systems, vol. 1 (Artech House, 2015), ch. 2 (equivalent circuits).</p>
</html>"));
end Polarisation;
