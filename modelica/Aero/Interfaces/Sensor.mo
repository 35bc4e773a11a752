within Aero.Interfaces;
partial model Sensor "What lies between a quantity and its reading"
  input Real u "True quantity";
  input Real du "Rate of change of the true quantity in its unit per second";
  output Real y "Reading";
  annotation (
    Documentation(info = "<html><p>Extend it with one equation for <code>y</code>. The rate <code>du</code> lets a lag start in its steady state.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Ellipse(extent = {{-70, 70}, {70, -70}}, lineColor = {60, 60, 60}, fillColor = {255, 248, 220}, fillPattern = FillPattern.Solid),
      Line(points = {{0, 0}, {40, 40}}, color = {60, 60, 60}, thickness = 1),
      Text(extent = {{-150, 120}, {150, 80}}, textString = "%name")}));
end Sensor;
