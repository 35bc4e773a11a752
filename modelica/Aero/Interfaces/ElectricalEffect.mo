within Aero.Interfaces;
partial model ElectricalEffect "What can lie between an amplifier and its motor"
  Interfaces.Pin p "Towards the amplifier" annotation (Placement(transformation(extent = {{-110, -10}, {-90, 10}})));
  Interfaces.Pin n "Towards the motor" annotation (Placement(transformation(extent = {{90, -10}, {110, 10}})));
  Interfaces.Pin r "Return" annotation (Placement(transformation(extent = {{-10, -110}, {10, -90}})));
  parameter Real orientation = 1 "1 where a positive motor voltage pitches the body up, -1 where it pitches it down";
  input Real w(unit = "rad/s") "Speed of the motor";
  annotation (
    Documentation(info = "<html><p>A three-pin element: in series between <code>p</code> and <code>n</code>, with the return <code>r</code> for effects that
depend on the voltage itself.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Line(points = {{-90, 0}, {-60, 0}}, color = {0, 0, 200}), Line(points = {{60, 0}, {90, 0}}, color = {0, 0, 200}),
      Line(points = {{0, -90}, {0, -40}}, color = {0, 0, 200}, pattern = LinePattern.Dash),
      Rectangle(extent = {{-60, 40}, {60, -40}}, lineColor = {0, 0, 200}, fillColor = {255, 248, 220}, fillPattern = FillPattern.Solid),
      Text(extent = {{-150, 90}, {150, 50}}, textString = "%name")}));
end ElectricalEffect;
