within Aero.Aerodynamics;
model LinearDrag "Drag torque that grows in proportion to the speed"
  extends Interfaces.DragLaw(k(unit = "N.m.s/rad", nominal = 1e-5));
equation
  tau = k * w;
  annotation (
    Documentation(info = "<html><p><code>tau = k w</code>, what the units in the paper's Table 1 say.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-80, -80}, {80, 80}}, color = {60, 60, 60})}));
end LinearDrag;
