within Aero.Aerodynamics;
model QuadraticThrust "Thrust that grows with the square of the speed"
  extends Interfaces.ThrustLaw(k(unit = "N.s2/rad2", nominal = 2.9e-7));
equation
  f = k * w * abs(w);
  annotation (
    Documentation(info = "<html><p>The paper's Eq. 4, <code>f = k w |w|</code>: signed, so that a propeller that turns backwards pulls backwards.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-80, -80}, {-40, -20}, {0, 0}, {40, 20}, {80, 80}}, color = {0, 110, 60}, smooth = Smooth.Bezier)}));
end QuadraticThrust;
