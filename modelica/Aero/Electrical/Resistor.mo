within Aero.Electrical;
model Resistor "Ideal resistor"
  parameter Real R(unit = "Ohm", nominal = 10) = 1 "Resistance";
  Interfaces.Pin p annotation (Placement(transformation(extent = {{-110, -10}, {-90, 10}})));
  Interfaces.Pin n annotation (Placement(transformation(extent = {{90, -10}, {110, 10}})));
equation
  p.i + n.i = 0;
  p.v - n.v = R * p.i;
  annotation (
    Documentation(info = "<html><p><code>v = R i</code></p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Line(points = {{-90, 0}, {-60, 0}}, color = {0, 0, 200}), Line(points = {{60, 0}, {90, 0}}, color = {0, 0, 200}),
      Rectangle(extent = {{-60, 25}, {60, -25}}, lineColor = {0, 0, 200}, fillColor = {255, 255, 255}, fillPattern = FillPattern.Solid),
      Text(extent = {{-150, 80}, {150, 40}}, textString = "%name")}));
end Resistor;
