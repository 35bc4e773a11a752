within Aero.Mechanical;
model PitchYawBody "Body that pitches on a yoke, which yaws"
  parameter Real J_p(unit = "kg.m2", nominal = 0.01) = 0.0219 "Moment of inertia of the body about the pitch axis";
  parameter Real J_y(unit = "kg.m2", nominal = 0.01) = 0.022 "Moment of inertia of body and yoke about the yaw axis, the body level";
  parameter Real D_p(unit = "N.m.s/rad", nominal = 0.01) = 0.0071 "Viscous damping about the pitch axis";
  parameter Real D_y(unit = "N.m.s/rad", nominal = 0.01) = 0.022 "Viscous damping about the yaw axis";
  parameter Real K_sp(unit = "N.m/rad", nominal = 0.1) = 0.0375 "Stiffness about the pitch axis";
  Interfaces.Flange pitch "Body about the pitch axis" annotation (Placement(transformation(extent = {{-110, -60}, {-90, -40}})));
  Interfaces.Flange yaw "Body about the yaw axis" annotation (Placement(transformation(extent = {{-110, 40}, {-90, 60}})));
  Real theta(unit = "rad", start = 0, fixed = true, nominal = 0.1) "Pitch angle";
  Real omega(unit = "rad/s", start = 0, fixed = true, nominal = 0.1) "Pitch rate";
  Real psi(unit = "rad", start = 0, fixed = true, nominal = 1) "Yaw angle";
  Real rate(unit = "rad/s", start = 0, fixed = true, nominal = 1) "Yaw rate";
equation
  omega = pitch.w;
  rate = yaw.w;
  der(theta) = omega;
  der(psi) = rate;
  J_p * der(omega) + D_p * omega + K_sp * sin(theta) + J_p * rate ^ 2 * sin(theta) * cos(theta) = pitch.tau;
  (J_y - J_p * sin(theta) ^ 2) * der(rate) + D_y * rate - 2 * J_p * omega * rate * sin(theta) * cos(theta) = yaw.tau;
  annotation (
    Documentation(info = "<html><p>The equations of a slender body across the pitch axis, from its kinetic energy
<code>J_p theta'^2 / 2 + (J_y - J_p sin(theta)^2) psi'^2 / 2</code>: while it yaws, the centrifugal torque draws it level, and a body that
pitches turns slower the more it reaches out. The stiffness is that of a centre of mass below the pivot.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Rectangle(extent = {{-30, -90}, {30, -80}}, lineColor = {60, 60, 60}, fillColor = {140, 140, 140}, fillPattern = FillPattern.Solid),
      Polygon(points = {{0, 10}, {-20, -80}, {20, -80}, {0, 10}}, lineColor = {60, 60, 60}, fillColor = {200, 210, 225}, fillPattern = FillPattern.Solid),
      Line(points = {{-80, -20}, {80, 40}}, color = {40, 80, 140}, thickness = 2),
      Ellipse(extent = {{-60, -40}, {60, -60}}, lineColor = {40, 80, 140}),
      Text(extent = {{-150, 110}, {150, 70}}, textString = "%name")}));
end PitchYawBody;
