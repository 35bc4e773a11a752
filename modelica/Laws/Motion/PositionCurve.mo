within Laws.Motion;
model PositionCurve "A force that depends on the displacement in an unlisted way"
  extends Laws.Interfaces.MotionLaw;
  parameter Real c_1(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = -x_n";
  parameter Real c_2(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = -3/4 x_n";
  parameter Real c_3(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = -1/2 x_n";
  parameter Real c_4(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = -1/4 x_n";
  parameter Real c_5(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = 0";
  parameter Real c_6(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = 1/4 x_n";
  parameter Real c_7(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = 1/2 x_n";
  parameter Real c_8(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = 3/4 x_n";
  parameter Real c_9(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near x = x_n";
equation
  f = c_1 * exp(-8 * (x / x_n + 1) ^ 2) + c_2 * exp(-8 * (x / x_n + 3/4) ^ 2)
    + c_3 * exp(-8 * (x / x_n + 1/2) ^ 2) + c_4 * exp(-8 * (x / x_n + 1/4) ^ 2)
    + c_5 * exp(-8 * (x / x_n) ^ 2) + c_6 * exp(-8 * (x / x_n - 1/4) ^ 2)
    + c_7 * exp(-8 * (x / x_n - 1/2) ^ 2) + c_8 * exp(-8 * (x / x_n - 3/4) ^ 2)
    + c_9 * exp(-8 * (x / x_n - 1) ^ 2);
  annotation (__aero_bayes(learned = "x"),
    Documentation(info = "<html>
<p>Overlapping bumps whose heights are learned, zero far outside of what was seen: a last resort, tried where listed laws leave structure.</p>
<p>Source: M. J. D. Powell, Radial basis functions for multivariable interpolation, in: Algorithms for Approximation (Oxford, 1987), 143-167.</p>
</html>"));
end PositionCurve;
