within Aero.Effects;
model ThrustLag "Thrust that follows the speed late"
  extends Interfaces.ThrustEffect;
  parameter Real T_f(unit = "s", min = 0, max = 3, nominal = 0.1) = 0 "Time constant of the thrust";
  parameter Real T_min(unit = "s", min = 1e-6) = 1e-3 "Time constant below which the lag is taken to first order";
  Real f(unit = "N", start = 0, fixed = true, nominal = 0.1) "Thrust after the lag";
protected
  parameter Real T(unit = "s") = max(T_f, T_min);
equation
  propeller.v = frame.v;
  T * der(f) = propeller.f - f;
  -frame.f = propeller.f - T_f / T * (propeller.f - f);
  annotation (
    Documentation(info = "<html>
<p>The wake needs time to build up: <code>T_f dF/dt = F_0 - F</code>. A lag shorter than <code>T_min</code> is taken to first order in
<code>T_f</code>, so that the equations stay regular down to <code>T_f = 0</code>, where nothing is left of it.</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-45, -25}, {-25, 5}, {0, 18}, {45, 22}}, color = {60, 60, 60})}));
end ThrustLag;
