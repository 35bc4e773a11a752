within Aero.Effects;
model SpeedLag "A reading that follows as a first-order lag"
  extends Interfaces.Sensor;
  parameter Real T_w(unit = "s", min = 0, max = 1, nominal = 0.03) = 0 "Time constant of the speed reading";
  parameter Real T_min(unit = "s", min = 1e-6) = 1e-3 "Time constant below which the lag is taken to first order";
  Real q(start = 0, fixed = true, nominal = 1000) "Rate of change of the reading";
protected
  parameter Real T(unit = "s") = max(T_w, T_min);
equation
  T * der(q) = du - q;
  y = u - T_w * q;
  annotation (
    Documentation(info = "<html>
<p>A filter in the instrument: <code>T_w dy/dt = u - y</code>, written by the rate so that it starts in its steady state whatever the
quantity is. A lag shorter than <code>T_min</code> is taken to first order in <code>T_w</code>; at zero nothing is left of it.</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-45, -25}, {-25, 5}, {0, 18}, {45, 22}}, color = {60, 60, 60})}));
end SpeedLag;
