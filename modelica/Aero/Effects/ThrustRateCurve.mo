within Aero.Effects;
model ThrustRateCurve "Loss of thrust that depends on the motion in an unlisted way"
  extends Interfaces.ThrustEffect;
  parameter Real x_n(unit = "m/s") = 1 "Largest velocity of the propeller along its axis";
  parameter Real c_1(unit = "1", min = -10, max = 10, nominal = 0.1) = 0 "Share of the thrust that is lost near -x_n";
  parameter Real c_2(unit = "1", min = -10, max = 10, nominal = 0.1) = 0 "Share of the thrust that is lost near -3/4 x_n";
  parameter Real c_3(unit = "1", min = -10, max = 10, nominal = 0.1) = 0 "Share of the thrust that is lost near -1/2 x_n";
  parameter Real c_4(unit = "1", min = -10, max = 10, nominal = 0.1) = 0 "Share of the thrust that is lost near -1/4 x_n";
  parameter Real c_5(unit = "1", min = -10, max = 10, nominal = 0.1) = 0 "Share of the thrust that is lost near 0";
  parameter Real c_6(unit = "1", min = -10, max = 10, nominal = 0.1) = 0 "Share of the thrust that is lost near 1/4 x_n";
  parameter Real c_7(unit = "1", min = -10, max = 10, nominal = 0.1) = 0 "Share of the thrust that is lost near 1/2 x_n";
  parameter Real c_8(unit = "1", min = -10, max = 10, nominal = 0.1) = 0 "Share of the thrust that is lost near 3/4 x_n";
  parameter Real c_9(unit = "1", min = -10, max = 10, nominal = 0.1) = 0 "Share of the thrust that is lost near x_n";
  Real x(unit = "m/s") "Velocity of the propeller along its axis";
  Real y(unit = "1") "Share of the thrust that is lost";
equation
  x = propeller.v;
  y = Functions.bumps(x / x_n, {c_1, c_2, c_3, c_4, c_5, c_6, c_7, c_8, c_9});
  propeller.v = frame.v;
  propeller.f + frame.f = propeller.f * y;
  annotation (__aero_bayes(learned = "x"),
    Documentation(info = "<html>
<p>Share of the thrust that does not reach the body: overlapping bumps whose heights are learned, zero far outside of what was seen. A last resort, tried where listed effects leave structure.</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-45, -20}, {-20, 15}, {10, -5}, {45, 20}}, color = {60, 60, 60}, smooth = Smooth.Bezier)}));
end ThrustRateCurve;
