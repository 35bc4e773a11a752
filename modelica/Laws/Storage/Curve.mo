within Laws.Storage;
model Curve "A flow that depends on the level in an unlisted way"
  extends Laws.Interfaces.StorageLaw;
  parameter Real c_1(min = -10 * q_n, max = 10 * q_n, nominal = 0.1 * q_n) = 0 "Flow near h = h_0 - h_n";
  parameter Real c_2(min = -10 * q_n, max = 10 * q_n, nominal = 0.1 * q_n) = 0 "Flow near h = h_0 - 3/4 h_n";
  parameter Real c_3(min = -10 * q_n, max = 10 * q_n, nominal = 0.1 * q_n) = 0 "Flow near h = h_0 - 1/2 h_n";
  parameter Real c_4(min = -10 * q_n, max = 10 * q_n, nominal = 0.1 * q_n) = 0 "Flow near h = h_0 - 1/4 h_n";
  parameter Real c_5(min = -10 * q_n, max = 10 * q_n, nominal = 0.1 * q_n) = 0 "Flow near h = h_0";
  parameter Real c_6(min = -10 * q_n, max = 10 * q_n, nominal = 0.1 * q_n) = 0 "Flow near h = h_0 + 1/4 h_n";
  parameter Real c_7(min = -10 * q_n, max = 10 * q_n, nominal = 0.1 * q_n) = 0 "Flow near h = h_0 + 1/2 h_n";
  parameter Real c_8(min = -10 * q_n, max = 10 * q_n, nominal = 0.1 * q_n) = 0 "Flow near h = h_0 + 3/4 h_n";
  parameter Real c_9(min = -10 * q_n, max = 10 * q_n, nominal = 0.1 * q_n) = 0 "Flow near h = h_0 + h_n";
equation
  q = c_1 * exp(-8 * ((h - h_0) / h_n + 1) ^ 2) + c_2 * exp(-8 * ((h - h_0) / h_n + 3/4) ^ 2)
    + c_3 * exp(-8 * ((h - h_0) / h_n + 1/2) ^ 2) + c_4 * exp(-8 * ((h - h_0) / h_n + 1/4) ^ 2)
    + c_5 * exp(-8 * ((h - h_0) / h_n) ^ 2) + c_6 * exp(-8 * ((h - h_0) / h_n - 1/4) ^ 2)
    + c_7 * exp(-8 * ((h - h_0) / h_n - 1/2) ^ 2) + c_8 * exp(-8 * ((h - h_0) / h_n - 3/4) ^ 2)
    + c_9 * exp(-8 * ((h - h_0) / h_n - 1) ^ 2);
  annotation (__aero_bayes(learned = "h"),
    Documentation(info = "<html>
<p>Overlapping bumps whose heights are learned, zero far outside of what was seen: a last resort, tried where listed laws leave structure.</p>
<p>Source: M. J. D. Powell, Radial basis functions for multivariable interpolation, in: Algorithms for Approximation (Oxford, 1987), 143-167.</p>
</html>"));
end Curve;
