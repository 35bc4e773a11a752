within Aero.Mechanical;
model Lever "Massless arm that carries a thruster on a pivoted body"
  parameter Real r(unit = "m", nominal = 0.1) = 0.1 "Length";
  Interfaces.ForceInput f "Thrust" annotation (Placement(transformation(extent = {{-110, -10}, {-90, 10}})));
  Interfaces.Flange flange annotation (Placement(transformation(extent = {{90, -10}, {110, 10}})));
  input Real w(unit = "rad/s") = 0 "Speed of the propeller, for laws of the thrust";
  Real v(unit = "m/s") "Velocity of the propeller along its axis, for laws of the thrust";
equation
  v = r * flange.w;
  flange.tau = -r * f;
  annotation (
    Documentation(info = "<html><p>Turns a force at the distance <code>r</code> from the pivot into a torque.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Line(points = {{-90, 0}, {90, 0}}, color = {60, 60, 60}, thickness = 2),
      Ellipse(extent = {{70, 20}, {110, -20}}, lineColor = {60, 60, 60}),
      Text(extent = {{-150, 80}, {150, 40}}, textString = "%name")}));
end Lever;
