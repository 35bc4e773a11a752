within Aero.Interfaces;
partial model DragLaw "Drag torque of a propeller as a function of its speed"
  parameter Real k = 0 "Coefficient; its unit follows from the law";
  input Real w(unit = "rad/s") "Speed of the propeller";
  output Real tau(unit = "N.m") "Torque that opposes the rotation";
  annotation (
    Documentation(info = "<html><p>Extend it with one equation for <code>tau</code>.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Rectangle(extent = {{-100, 100}, {100, -100}}, lineColor = {60, 60, 60}, fillColor = {255, 255, 255}, fillPattern = FillPattern.Solid),
      Line(points = {{-80, 0}, {80, 0}}, color = {160, 160, 160}), Line(points = {{0, -80}, {0, 80}}, color = {160, 160, 160}),
      Text(extent = {{-150, 150}, {150, 110}}, textString = "%name")}));
end DragLaw;
