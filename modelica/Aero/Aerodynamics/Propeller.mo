within Aero.Aerodynamics;
model Propeller "Propeller with replaceable laws of thrust and drag"
  parameter Real k_t = 2.9e-7 "Thrust coefficient; its unit follows from the law";
  parameter Real k_d = 2.4e-8 "Drag coefficient; its unit follows from the law";
  replaceable model ThrustLaw = QuadraticThrust constrainedby Interfaces.ThrustLaw "Law of the thrust" annotation (choicesAllMatching = true);
  replaceable model DragLaw = QuadraticDrag constrainedby Interfaces.DragLaw "Law of the drag torque" annotation (choicesAllMatching = true);
  Interfaces.Flange flange "Shaft" annotation (Placement(transformation(extent = {{-110, -10}, {-90, 10}})));
  Interfaces.ForceOutput f "Thrust along the axis" annotation (Placement(transformation(extent = {{90, -10}, {110, 10}})));
  ThrustLaw thrust(k = k_t, w = flange.w) annotation (Placement(transformation(extent = {{20, 20}, {40, 40}})));
  DragLaw drag(k = k_d, w = flange.w) annotation (Placement(transformation(extent = {{-40, -40}, {-20, -20}})));
equation
  f = thrust.f;
  flange.tau = drag.tau;
  annotation (
    Documentation(info = "<html><p>Takes torque from the shaft and gives a thrust; both follow from the speed alone.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Line(points = {{-90, 0}, {90, 0}}, color = {60, 60, 60}),
      Ellipse(extent = {{-15, 90}, {15, 0}}, lineColor = {0, 110, 60}, fillColor = {200, 225, 210}, fillPattern = FillPattern.Solid),
      Ellipse(extent = {{-15, 0}, {15, -90}}, lineColor = {0, 110, 60}, fillColor = {200, 225, 210}, fillPattern = FillPattern.Solid),
      Text(extent = {{-150, 140}, {150, 100}}, textString = "%name")}));
end Propeller;
