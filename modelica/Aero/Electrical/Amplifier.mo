within Aero.Electrical;
model Amplifier "Ideal voltage amplifier"
  input Real u(unit = "V") "Commanded voltage";
  Interfaces.Pin p annotation (Placement(transformation(extent = {{90, 40}, {110, 60}})));
  Interfaces.Pin n annotation (Placement(transformation(extent = {{90, -60}, {110, -40}})));
equation
  p.i + n.i = 0;
  p.v - n.v = u;
  annotation (
    Documentation(info = "<html><p>Holds the commanded voltage between its pins whatever the current.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Polygon(points = {{-70, 80}, {70, 0}, {-70, -80}, {-70, 80}}, lineColor = {0, 0, 200}, fillColor = {255, 255, 255}, fillPattern = FillPattern.Solid),
      Text(extent = {{-150, 130}, {150, 90}}, textString = "%name")}));
end Amplifier;
