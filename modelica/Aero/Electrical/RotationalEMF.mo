within Aero.Electrical;
model RotationalEMF "Electromechanical converter of a DC motor"
  parameter Real c(unit = "N.m/A", nominal = 0.05) = 0.05 "Torque constant, equal to the back-EMF constant in V.s/rad";
  Interfaces.Pin p annotation (Placement(transformation(extent = {{-110, -10}, {-90, 10}})));
  Interfaces.Pin n annotation (Placement(transformation(extent = {{-10, -110}, {10, -90}})));
  Interfaces.Flange flange "Rotor shaft" annotation (Placement(transformation(extent = {{90, -10}, {110, 10}})));
equation
  p.i + n.i = 0;
  p.v - n.v = c * flange.w;
  flange.tau = -c * p.i;
  annotation (
    Documentation(info = "<html><p>Back EMF <code>E = c w</code> (the paper's Eq. 2) and torque <code>c i</code>; power is kept.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Line(points = {{-90, 0}, {-40, 0}}, color = {0, 0, 200}), Line(points = {{0, -90}, {0, -40}}, color = {0, 0, 200}),
      Ellipse(extent = {{-40, 40}, {40, -40}}, lineColor = {0, 0, 200}, fillColor = {255, 255, 255}, fillPattern = FillPattern.Solid),
      Rectangle(extent = {{40, 8}, {90, -8}}, lineColor = {60, 60, 60}, fillColor = {170, 170, 170}, fillPattern = FillPattern.Solid),
      Text(extent = {{-150, 90}, {150, 50}}, textString = "%name")}));
end RotationalEMF;
