within Aero.Mechanical;
model Torque "Given torque"
  input Real tau(unit = "N.m") "Torque that drives the flange";
  Interfaces.Flange flange annotation (Placement(transformation(extent = {{90, -10}, {110, 10}})));
equation
  flange.tau = -tau;
  annotation (
    Documentation(info = "<html><p>Drives its flange with a torque whatever the speed.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Line(points = {{-80, -40}, {-40, 30}, {30, 50}, {80, 0}}, color = {60, 60, 60}, thickness = 1, arrow = {Arrow.None, Arrow.Filled}),
      Text(extent = {{-150, 110}, {150, 70}}, textString = "%name")}));
end Torque;
