within Aero.Effects;
model RotorCurve "A braking torque that depends on the speed in an unlisted way"
  extends Interfaces.RotorEffect;
  parameter Real x_n(unit = "rad/s") = 1 "Largest speed of the rotor";
  parameter Real c_1(unit = "N.m", min = -0.1, max = 0.1, nominal = 0.001) = 0 "Braking torque near -x_n";
  parameter Real c_2(unit = "N.m", min = -0.1, max = 0.1, nominal = 0.001) = 0 "Braking torque near -3/4 x_n";
  parameter Real c_3(unit = "N.m", min = -0.1, max = 0.1, nominal = 0.001) = 0 "Braking torque near -1/2 x_n";
  parameter Real c_4(unit = "N.m", min = -0.1, max = 0.1, nominal = 0.001) = 0 "Braking torque near -1/4 x_n";
  parameter Real c_5(unit = "N.m", min = -0.1, max = 0.1, nominal = 0.001) = 0 "Braking torque near 0";
  parameter Real c_6(unit = "N.m", min = -0.1, max = 0.1, nominal = 0.001) = 0 "Braking torque near 1/4 x_n";
  parameter Real c_7(unit = "N.m", min = -0.1, max = 0.1, nominal = 0.001) = 0 "Braking torque near 1/2 x_n";
  parameter Real c_8(unit = "N.m", min = -0.1, max = 0.1, nominal = 0.001) = 0 "Braking torque near 3/4 x_n";
  parameter Real c_9(unit = "N.m", min = -0.1, max = 0.1, nominal = 0.001) = 0 "Braking torque near x_n";
  Real x(unit = "rad/s") "Speed of the rotor";
  Real y(unit = "N.m") "Braking torque";
equation
  x = flange.w;
  y = Functions.bumps(x / x_n, {c_1, c_2, c_3, c_4, c_5, c_6, c_7, c_8, c_9});
  flange.tau = y;
  annotation (__aero_bayes(learned = "x"),
    Documentation(info = "<html>
<p>Torque on the shaft: overlapping bumps whose heights are learned, zero far outside of what was seen. A last resort, tried where listed effects leave structure.</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-45, -20}, {-20, 15}, {10, -5}, {45, 20}}, color = {60, 60, 60}, smooth = Smooth.Bezier)}));
end RotorCurve;
