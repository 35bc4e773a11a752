within Laws.Motion;
model Curve "A force that depends on the speed in an unlisted way"
  extends Laws.Interfaces.MotionLaw;
  parameter Real c_1(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near v = -v_n";
  parameter Real c_2(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near v = -2/3 v_n";
  parameter Real c_3(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near v = -1/3 v_n";
  parameter Real c_4(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near v = 0";
  parameter Real c_5(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near v = 1/3 v_n";
  parameter Real c_6(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near v = 2/3 v_n";
  parameter Real c_7(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force near v = v_n";
equation
  f = c_1 * exp(-4.5 * (v / v_n + 1) ^ 2) + c_2 * exp(-4.5 * (v / v_n + 2/3) ^ 2)
    + c_3 * exp(-4.5 * (v / v_n + 1/3) ^ 2) + c_4 * exp(-4.5 * (v / v_n) ^ 2)
    + c_5 * exp(-4.5 * (v / v_n - 1/3) ^ 2) + c_6 * exp(-4.5 * (v / v_n - 2/3) ^ 2)
    + c_7 * exp(-4.5 * (v / v_n - 1) ^ 2);
  annotation (__aero_bayes(learned = "v"),
    Documentation(info = "<html>
<p>Overlapping bumps whose heights are learned, zero far outside of what was seen: a last resort, tried where listed laws leave structure.</p>
<p>Source: M. J. D. Powell, Radial basis functions for multivariable interpolation, in: Algorithms for Approximation (Oxford, 1987), 143-167.</p>
</html>"));
end Curve;
