within Aero.Aerodynamics;
model QuadraticDrag "Drag torque that grows with the square of the speed"
  extends Interfaces.DragLaw(k(unit = "N.m.s2/rad2", nominal = 1e-8));
equation
  tau = k * w * abs(w);
  annotation (
    Documentation(info = "<html><p>The paper's Eq. 5, <code>tau = k w |w|</code>: always against the rotation.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-80, -80}, {-40, -20}, {0, 0}, {40, 20}, {80, 80}}, color = {60, 60, 60}, smooth = Smooth.Bezier)}));
end QuadraticDrag;
