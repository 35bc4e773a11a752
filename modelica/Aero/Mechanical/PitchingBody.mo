within Aero.Mechanical;
model PitchingBody "Body on a pivot with damping and restoring torque"
  parameter Real J_p(unit = "kg.m2", nominal = 0.01) = 0.0219 "Moment of inertia about the pitch axis";
  parameter Real D_p(unit = "N.m.s/rad", nominal = 0.01) = 0.0071 "Viscous damping about the pitch axis";
  parameter Real K_sp(unit = "N.m/rad", nominal = 0.1) = 0.0375 "Stiffness about the pitch axis";
  Interfaces.Flange flange "Body at the pivot" annotation (Placement(transformation(extent = {{-110, -10}, {-90, 10}})));
  Real theta(unit = "rad", start = 0, fixed = true, nominal = 0.1) "Pitch angle";
  Real omega(unit = "rad/s", start = 0, fixed = true, nominal = 0.1) "Pitch rate";
equation
  omega = flange.w;
  der(theta) = omega;
  J_p * der(omega) + D_p * omega + K_sp * theta = flange.tau;
  annotation (
    Documentation(info = "<html><p><code>J_p theta'' + D_p theta' + K_sp theta = tau</code>. The stiffness is that of a centre of mass below the pivot, for
small angles.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Line(points = {{-80, -20}, {80, 40}}, color = {40, 80, 140}, thickness = 2),
      Polygon(points = {{0, 10}, {-25, -80}, {25, -80}, {0, 10}}, lineColor = {60, 60, 60}, fillColor = {200, 210, 225}, fillPattern = FillPattern.Solid),
      Text(extent = {{-150, 110}, {150, 70}}, textString = "%name")}));
end PitchingBody;
