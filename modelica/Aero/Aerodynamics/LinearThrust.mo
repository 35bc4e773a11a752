within Aero.Aerodynamics;
model LinearThrust "Thrust that grows in proportion to the speed"
  extends Interfaces.ThrustLaw(k(unit = "N.s/rad", nominal = 1e-4));
equation
  f = k * w;
  annotation (
    Documentation(info = "<html><p><code>f = k w</code>, what the units in the paper's Table 1 say.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-80, -80}, {80, 80}}, color = {0, 110, 60})}));
end LinearThrust;
