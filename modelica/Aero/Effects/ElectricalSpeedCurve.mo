within Aero.Effects;
model ElectricalSpeedCurve "A voltage drop that depends on the speed in an unlisted way"
  extends Interfaces.ElectricalEffect;
  parameter Real x_n(unit = "rad/s") = 1 "Largest speed of the motor";
  parameter Real c_1(unit = "V", min = -100, max = 100, nominal = 1) = 0 "Voltage drop near -x_n";
  parameter Real c_2(unit = "V", min = -100, max = 100, nominal = 1) = 0 "Voltage drop near -3/4 x_n";
  parameter Real c_3(unit = "V", min = -100, max = 100, nominal = 1) = 0 "Voltage drop near -1/2 x_n";
  parameter Real c_4(unit = "V", min = -100, max = 100, nominal = 1) = 0 "Voltage drop near -1/4 x_n";
  parameter Real c_5(unit = "V", min = -100, max = 100, nominal = 1) = 0 "Voltage drop near 0";
  parameter Real c_6(unit = "V", min = -100, max = 100, nominal = 1) = 0 "Voltage drop near 1/4 x_n";
  parameter Real c_7(unit = "V", min = -100, max = 100, nominal = 1) = 0 "Voltage drop near 1/2 x_n";
  parameter Real c_8(unit = "V", min = -100, max = 100, nominal = 1) = 0 "Voltage drop near 3/4 x_n";
  parameter Real c_9(unit = "V", min = -100, max = 100, nominal = 1) = 0 "Voltage drop near x_n";
  Real x(unit = "rad/s") "Speed of the motor";
  Real y(unit = "V") "Voltage drop";
equation
  x = w;
  y = Functions.bumps(x / x_n, {c_1, c_2, c_3, c_4, c_5, c_6, c_7, c_8, c_9});
  p.i + n.i = 0;
  r.i = 0;
  p.v - n.v = y;
  annotation (__aero_bayes(learned = "x"),
    Documentation(info = "<html>
<p>Voltage lost between amplifier and motor: overlapping bumps whose heights are learned, zero far outside of what was seen. A last resort, tried where listed effects leave structure.</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-45, -20}, {-20, 15}, {10, -5}, {45, 20}}, color = {60, 60, 60}, smooth = Smooth.Bezier)}));
end ElectricalSpeedCurve;
