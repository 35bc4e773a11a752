within Aero.Interfaces;
partial model BodyEffect "What can act at the body's pivot"
  Interfaces.Flange flange "Body at the pivot" annotation (Placement(transformation(extent = {{-110, -10}, {-90, 10}})));
  input Real theta(unit = "rad") "Pitch angle";
  annotation (
    Documentation(info = "<html><p>A torque in parallel at the pivot; <code>flange.tau</code> is positive where it opposes a positive motion. The pitch
angle is given beside the flange, which carries only the speed.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Line(points = {{-90, 0}, {-60, 0}}, color = {60, 60, 60}),
      Rectangle(extent = {{-60, 40}, {60, -40}}, lineColor = {60, 60, 60}, fillColor = {255, 248, 220}, fillPattern = FillPattern.Solid),
      Text(extent = {{-150, 90}, {150, 50}}, textString = "%name")}));
end BodyEffect;
