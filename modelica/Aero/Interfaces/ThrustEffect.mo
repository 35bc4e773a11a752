within Aero.Interfaces;
partial model ThrustEffect "What can lie between a propeller and the body that carries it"
  parameter Real orientation = 1 "1 where positive thrust pitches the body up, -1 where it pitches it down";
  Interfaces.Mount propeller "Towards the propeller" annotation (Placement(transformation(extent = {{-110, -10}, {-90, 10}})));
  Interfaces.Mount frame "Towards the body" annotation (Placement(transformation(extent = {{90, -10}, {110, 10}})));
  input Real w(unit = "rad/s") "Speed of the propeller";
  input Real theta(unit = "rad") "Pitch angle of the body";
  annotation (
    Documentation(info = "<html><p>Extend it with <code>propeller.v = frame.v</code> and one equation between <code>propeller.f</code> and <code>frame.f</code>. The thrust that the propeller
makes is <code>propeller.f</code>, the thrust that reaches the body is <code>-frame.f</code>.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Line(points = {{-90, 0}, {-60, 0}}, color = {0, 110, 60}), Line(points = {{60, 0}, {90, 0}}, color = {0, 110, 60}),
      Rectangle(extent = {{-60, 40}, {60, -40}}, lineColor = {0, 110, 60}, fillColor = {255, 248, 220}, fillPattern = FillPattern.Solid),
      Text(extent = {{-150, 90}, {150, 50}}, textString = "%name")}));
end ThrustEffect;
