within Aero.Interfaces;
partial model ThrustLaw "Thrust of a propeller as a function of its speed"
  parameter Real k = 0 "Coefficient; its unit follows from the law";
  input Real w(unit = "rad/s") "Speed of the propeller";
  output Real f(unit = "N") "Thrust along the propeller's axis";
  annotation (
    Documentation(info = "<html><p>Extend it with one equation for <code>f</code>.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Rectangle(extent = {{-100, 100}, {100, -100}}, lineColor = {0, 110, 60}, fillColor = {255, 255, 255}, fillPattern = FillPattern.Solid),
      Line(points = {{-80, 0}, {80, 0}}, color = {160, 160, 160}), Line(points = {{0, -80}, {0, 80}}, color = {160, 160, 160}),
      Text(extent = {{-150, 150}, {150, 110}}, textString = "%name")}));
end ThrustLaw;
