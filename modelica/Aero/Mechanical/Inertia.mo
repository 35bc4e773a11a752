within Aero.Mechanical;
model Inertia "Rotating mass"
  parameter Real J(unit = "kg.m2", nominal = 1e-5) = 1 "Moment of inertia";
  Interfaces.Flange flange_a annotation (Placement(transformation(extent = {{-110, -10}, {-90, 10}})));
  Interfaces.Flange flange_b annotation (Placement(transformation(extent = {{90, -10}, {110, 10}})));
  Real w(unit = "rad/s", start = 0, fixed = true, nominal = 100) "Angular velocity";
equation
  w = flange_a.w;
  flange_a.w = flange_b.w;
  J * der(w) = flange_a.tau + flange_b.tau;
  annotation (
    Documentation(info = "<html><p><code>J dw/dt</code> is the sum of the torques at both flanges (the paper's Eq. 3).</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Rectangle(extent = {{-90, 8}, {90, -8}}, lineColor = {60, 60, 60}, fillColor = {170, 170, 170}, fillPattern = FillPattern.HorizontalCylinder),
      Rectangle(extent = {{-40, 60}, {40, -60}}, lineColor = {60, 60, 60}, fillColor = {200, 210, 225}, fillPattern = FillPattern.HorizontalCylinder),
      Text(extent = {{-150, 110}, {150, 70}}, textString = "%name")}));
end Inertia;
