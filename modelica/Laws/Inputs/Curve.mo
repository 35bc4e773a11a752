within Laws.Inputs;
model Curve "An actuator whose gain depends on its input in an unlisted way"
  extends Laws.Interfaces.InputLaw;
  parameter Real c_1(min = -1, max = 1, nominal = 0.1) = 0 "Share of u_n near u = -u_n";
  parameter Real c_2(min = -1, max = 1, nominal = 0.1) = 0 "Share of u_n near u = -2/3 u_n";
  parameter Real c_3(min = -1, max = 1, nominal = 0.1) = 0 "Share of u_n near u = -1/3 u_n";
  parameter Real c_4(min = -1, max = 1, nominal = 0.1) = 0 "Share of u_n near u = 0";
  parameter Real c_5(min = -1, max = 1, nominal = 0.1) = 0 "Share of u_n near u = 1/3 u_n";
  parameter Real c_6(min = -1, max = 1, nominal = 0.1) = 0 "Share of u_n near u = 2/3 u_n";
  parameter Real c_7(min = -1, max = 1, nominal = 0.1) = 0 "Share of u_n near u = u_n";
equation
  y = u + u_n * (c_1 * exp(-4.5 * (u / u_n + 1) ^ 2) + c_2 * exp(-4.5 * (u / u_n + 2/3) ^ 2)
    + c_3 * exp(-4.5 * (u / u_n + 1/3) ^ 2) + c_4 * exp(-4.5 * (u / u_n) ^ 2)
    + c_5 * exp(-4.5 * (u / u_n - 1/3) ^ 2) + c_6 * exp(-4.5 * (u / u_n - 2/3) ^ 2)
    + c_7 * exp(-4.5 * (u / u_n - 1) ^ 2));
  annotation (__aero_bayes(learned = "u"),
    Documentation(info = "<html>
<p>Overlapping bumps whose heights are learned, zero far outside of what was seen: a last resort, tried where listed laws leave structure.</p>
<p>Source: M. J. D. Powell, Radial basis functions for multivariable interpolation, in: Algorithms for Approximation (Oxford, 1987), 143-167.</p>
</html>"));
end Curve;
