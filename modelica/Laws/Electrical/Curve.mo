within Laws.Electrical;
model Curve "A voltage that depends on the current in an unlisted way"
  extends Laws.Interfaces.SeriesLaw;
  parameter Real c_1(min = -10 * v_n, max = 10 * v_n, nominal = 0.1 * v_n) = 0 "Voltage near i = -i_n";
  parameter Real c_2(min = -10 * v_n, max = 10 * v_n, nominal = 0.1 * v_n) = 0 "Voltage near i = -2/3 i_n";
  parameter Real c_3(min = -10 * v_n, max = 10 * v_n, nominal = 0.1 * v_n) = 0 "Voltage near i = -1/3 i_n";
  parameter Real c_4(min = -10 * v_n, max = 10 * v_n, nominal = 0.1 * v_n) = 0 "Voltage near i = 0";
  parameter Real c_5(min = -10 * v_n, max = 10 * v_n, nominal = 0.1 * v_n) = 0 "Voltage near i = 1/3 i_n";
  parameter Real c_6(min = -10 * v_n, max = 10 * v_n, nominal = 0.1 * v_n) = 0 "Voltage near i = 2/3 i_n";
  parameter Real c_7(min = -10 * v_n, max = 10 * v_n, nominal = 0.1 * v_n) = 0 "Voltage near i = i_n";
equation
  v = c_1 * exp(-4.5 * (i / i_n + 1) ^ 2) + c_2 * exp(-4.5 * (i / i_n + 2/3) ^ 2)
    + c_3 * exp(-4.5 * (i / i_n + 1/3) ^ 2) + c_4 * exp(-4.5 * (i / i_n) ^ 2)
    + c_5 * exp(-4.5 * (i / i_n - 1/3) ^ 2) + c_6 * exp(-4.5 * (i / i_n - 2/3) ^ 2)
    + c_7 * exp(-4.5 * (i / i_n - 1) ^ 2);
  annotation (__aero_bayes(learned = "i"),
    Documentation(info = "<html>
<p>Overlapping bumps whose heights are learned, zero far outside of what was seen: a last resort, tried where listed laws leave structure.</p>
<p>Source: M. J. D. Powell, Radial basis functions for multivariable interpolation, in: Algorithms for Approximation (Oxford, 1987), 143-167.</p>
</html>"));
end Curve;
