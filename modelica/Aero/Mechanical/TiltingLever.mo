within Aero.Mechanical;
model TiltingLever "Massless arm that is fixed to a pitching body and turns it about the vertical axis"
  parameter Real r(unit = "m", nominal = 0.1) = 0.1 "Length; negative where positive thrust yaws the body to negative angles";
  input Real theta(unit = "rad") "Pitch angle of the arm";
  Interfaces.ForceInput f "Thrust" annotation (Placement(transformation(extent = {{-110, -10}, {-90, 10}})));
  Interfaces.Flange flange annotation (Placement(transformation(extent = {{90, -10}, {110, 10}})));
equation
  flange.tau = -r * cos(theta) * f;
  annotation (
    Documentation(info = "<html><p>A <code>Lever</code> whose distance from the axis shortens as the body pitches; the force is level.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Line(points = {{-90, 0}, {90, 0}}, color = {160, 160, 160}, pattern = LinePattern.Dash),
      Line(points = {{-80, 30}, {90, 0}}, color = {60, 60, 60}, thickness = 2),
      Ellipse(extent = {{70, 20}, {110, -20}}, lineColor = {60, 60, 60}),
      Text(extent = {{-150, 80}, {150, 40}}, textString = "%name")}));
end TiltingLever;
