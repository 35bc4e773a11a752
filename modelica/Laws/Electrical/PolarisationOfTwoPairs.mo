within Laws.Electrical;
model PolarisationOfTwoPairs "A voltage that builds up over two pairs of a resistor and a capacitor, a fast one and a slow one"
  extends Laws.Interfaces.SeriesLaw;
  parameter Real R_1(min = 0, max = 10 * v_n / i_n, nominal = 0.1 * v_n / i_n) = 0 "Resistance of both pairs together";
  parameter Real T_1(min = 0.1 * t_n, max = 1000 * t_n, nominal = 3 * t_n) = 3 * t_n "Time constant of the fast pair";
  parameter Real s_2(min = 0, max = 1, nominal = 0.5) = 0.5 "Share of the slow pair in the resistance";
  parameter Real a_2(min = 2, max = 50, nominal = 10) = 10 "Time constant of the slow pair over that of the fast one";
  parameter Real start_i_1(min = -10 * i_n, max = 10 * i_n, nominal = i_n) = 0 "Current through the resistance of the fast pair at the start, beyond the current";
  parameter Real start_i_2(min = -10 * i_n, max = 10 * i_n, nominal = i_n) = 0 "Current through the resistance of the slow pair at the start, beyond the current";
  Real i_1(nominal = i_n) "Current through the resistance of the fast pair";
  Real i_2(nominal = i_n) "Current through the resistance of the slow pair";
initial equation
  i_1 = i + start_i_1;
  i_2 = i + start_i_2;
equation
  T_1 * der(i_1) = i - i_1;
  a_2 * T_1 * der(i_2) = i - i_2;
  v = R_1 * ((1 - s_2) * i_1 + s_2 * i_2);
  annotation (__aero_bayes(refines = "polarisation"), Documentation(info = "<html>
<p>Two pairs in series: charge transfer in seconds and diffusion in minutes. The current before the start was what it is there, or <code>start_i_1</code> and <code>start_i_2</code> more.</p>
<p>Source: G. L. Plett, Battery Management Systems, vol. 1 (Artech House, 2015), ch. 2 (equivalent circuits).</p>
</html>"));
end PolarisationOfTwoPairs;
