within Laws.Motion;
model FinePositionCurve "A force that ripples over the displacement in an unlisted way"
  extends Laws.Interfaces.MotionLaw;
  parameter Real c_1(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = -x_n";
  parameter Real c_2(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = -11/12 x_n";
  parameter Real c_3(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = -10/12 x_n";
  parameter Real c_4(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = -9/12 x_n";
  parameter Real c_5(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = -8/12 x_n";
  parameter Real c_6(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = -7/12 x_n";
  parameter Real c_7(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = -6/12 x_n";
  parameter Real c_8(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = -5/12 x_n";
  parameter Real c_9(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = -4/12 x_n";
  parameter Real c_10(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = -3/12 x_n";
  parameter Real c_11(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = -2/12 x_n";
  parameter Real c_12(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = -1/12 x_n";
  parameter Real c_13(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = 0";
  parameter Real c_14(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = 1/12 x_n";
  parameter Real c_15(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = 2/12 x_n";
  parameter Real c_16(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = 3/12 x_n";
  parameter Real c_17(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = 4/12 x_n";
  parameter Real c_18(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = 5/12 x_n";
  parameter Real c_19(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = 6/12 x_n";
  parameter Real c_20(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = 7/12 x_n";
  parameter Real c_21(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = 8/12 x_n";
  parameter Real c_22(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = 9/12 x_n";
  parameter Real c_23(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = 10/12 x_n";
  parameter Real c_24(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = 11/12 x_n";
  parameter Real c_25(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = x_n";
equation
  f = c_1 * exp(-72 * (x / x_n + 1) ^ 2) + c_2 * exp(-72 * (x / x_n + 11/12) ^ 2)
    + c_3 * exp(-72 * (x / x_n + 10/12) ^ 2) + c_4 * exp(-72 * (x / x_n + 9/12) ^ 2)
    + c_5 * exp(-72 * (x / x_n + 8/12) ^ 2) + c_6 * exp(-72 * (x / x_n + 7/12) ^ 2)
    + c_7 * exp(-72 * (x / x_n + 6/12) ^ 2) + c_8 * exp(-72 * (x / x_n + 5/12) ^ 2)
    + c_9 * exp(-72 * (x / x_n + 4/12) ^ 2) + c_10 * exp(-72 * (x / x_n + 3/12) ^ 2)
    + c_11 * exp(-72 * (x / x_n + 2/12) ^ 2) + c_12 * exp(-72 * (x / x_n + 1/12) ^ 2)
    + c_13 * exp(-72 * (x / x_n) ^ 2) + c_14 * exp(-72 * (x / x_n - 1/12) ^ 2)
    + c_15 * exp(-72 * (x / x_n - 2/12) ^ 2) + c_16 * exp(-72 * (x / x_n - 3/12) ^ 2)
    + c_17 * exp(-72 * (x / x_n - 4/12) ^ 2) + c_18 * exp(-72 * (x / x_n - 5/12) ^ 2)
    + c_19 * exp(-72 * (x / x_n - 6/12) ^ 2) + c_20 * exp(-72 * (x / x_n - 7/12) ^ 2)
    + c_21 * exp(-72 * (x / x_n - 8/12) ^ 2) + c_22 * exp(-72 * (x / x_n - 9/12) ^ 2)
    + c_23 * exp(-72 * (x / x_n - 10/12) ^ 2) + c_24 * exp(-72 * (x / x_n - 11/12) ^ 2)
    + c_25 * exp(-72 * (x / x_n - 1) ^ 2);
  annotation (__aero_bayes(learned = "x", refines = "position_curve"),
    Documentation(info = "<html>
<p>Overlapping bumps whose heights are learned, zero far outside of what was seen: a last resort, tried where fewer bumps do not do.</p>
<p>Source: M. J. D. Powell, Radial basis functions for multivariable interpolation, in: Algorithms for Approximation (Oxford, 1987), 143-167.</p>
</html>"));
end FinePositionCurve;
