within Aero.Interfaces;
partial model RotorEffect "What can act on a rotor's shaft"
  Interfaces.Flange flange "Rotor shaft" annotation (Placement(transformation(extent = {{-110, -10}, {-90, 10}})));
  parameter Real orientation = 1 "1 where a positive speed pitches the body up, -1 where it pitches it down";
  input Real i(unit = "A") "Current of the motor";
  annotation (
    Documentation(info = "<html><p>A torque in parallel at the shaft; <code>flange.tau</code> is positive where it brakes a positive speed.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Line(points = {{-90, 0}, {-60, 0}}, color = {60, 60, 60}),
      Rectangle(extent = {{-60, 40}, {60, -40}}, lineColor = {60, 60, 60}, fillColor = {255, 248, 220}, fillPattern = FillPattern.Solid),
      Text(extent = {{-150, 90}, {150, 50}}, textString = "%name")}));
end RotorEffect;
