within Aero.Electrical;
model Inductor "Ideal inductor"
  parameter Real L(unit = "H", nominal = 1e-3) = 1e-3 "Inductance";
  Interfaces.Pin p annotation (Placement(transformation(extent = {{-110, -10}, {-90, 10}})));
  Interfaces.Pin n annotation (Placement(transformation(extent = {{90, -10}, {110, 10}})));
  Real i(unit = "A", start = 0, fixed = true, nominal = 0.1) "Current from p to n";
equation
  i = p.i;
  p.i + n.i = 0;
  p.v - n.v = L * der(i);
  annotation (
    Documentation(info = "<html><p><code>v = L di/dt</code></p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Line(points = {{-90, 0}, {-60, 0}}, color = {0, 0, 200}), Line(points = {{60, 0}, {90, 0}}, color = {0, 0, 200}),
      Ellipse(extent = {{-60, 15}, {-20, -15}}, lineColor = {0, 0, 200}), Ellipse(extent = {{-20, 15}, {20, -15}}, lineColor = {0, 0, 200}),
      Ellipse(extent = {{20, 15}, {60, -15}}, lineColor = {0, 0, 200}),
      Text(extent = {{-150, 80}, {150, 40}}, textString = "%name")}));
end Inductor;
