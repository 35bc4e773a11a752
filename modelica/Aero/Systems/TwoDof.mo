within Aero.Systems;
model TwoDof "Two-degree-of-freedom set-up: the body free in pitch and yaw, each motor driven by its own voltage"
  parameter Real R_a(unit = "Ohm", min = 0.1, max = 100, nominal = 8.4) = 8.4 "Armature resistance of a motor";
  parameter Real L_a(unit = "H", min = 1e-5, max = 0.1, nominal = 1.16e-3) = 1.16e-3 "Armature inductance of a motor";
  parameter Real c_m(unit = "N.m/A", min = 1e-3, max = 1, nominal = 0.042) = 0.042 "Mechanical torque constant of a motor, also its back-EMF constant in V.s/rad";
  parameter Real J_r(unit = "kg.m2", min = 1e-8, max = 1e-3, nominal = 1e-5) = 1e-5 "Moment of inertia of a motor's rotor with its propeller";
  parameter Real J_s(unit = "kg.m2", min = 0, max = 1e-3, nominal = 4e-6) = 4e-6 "Moment of inertia of a motor's stator part that turns along";
  parameter Real k_d(unit = "N.m.s2/rad2", min = 0, max = 1e-5, nominal = 1e-7) = 1e-7 "Aerodynamic drag coefficient of the main propeller";
  parameter Real k_dt(unit = "N.m.s2/rad2", min = 0, max = 1e-5, nominal = 1e-7) = 1e-7 "Aerodynamic drag coefficient of the tail propeller";
  parameter Real k_t(unit = "N.s2/rad2", min = 0, max = 1e-3, nominal = 1.2e-6) = 1.2e-6 "Aerodynamic thrust coefficient of the main propeller";
  parameter Real k_tt(unit = "N.s2/rad2", min = 0, max = 1e-3, nominal = 1.2e-6) = 1.2e-6 "Aerodynamic thrust coefficient of the tail propeller";
  parameter Real J_p(unit = "kg.m2", min = 1e-4, max = 1, nominal = 0.0219) = 0.0219 "Moment of inertia of the body about the pitch axis";
  parameter Real J_y(unit = "kg.m2", min = 1e-3, max = 1, nominal = 0.022) = 0.022 "Moment of inertia of body and yoke about the yaw axis, the body level";
  parameter Real D_p(unit = "N.m.s/rad", min = 0, max = 1, nominal = 0.0071) = 0.0071 "Viscous damping of the body about the pitch axis";
  parameter Real D_y(unit = "N.m.s/rad", min = 0, max = 1, nominal = 0.022) = 0.022 "Viscous damping of the body about the yaw axis";
  parameter Real K_sp(unit = "N.m/rad", min = 1e-4, max = 10, nominal = 0.0375) = 0.0375 "Stiffness of the body about the pitch axis";
  parameter Real D_t(unit = "m", min = 0.01, max = 1, nominal = 0.158) = 0.158 "Distance of a thruster from the pitch axis and from the yaw axis";
  replaceable model ThrustLaw = Aerodynamics.QuadraticThrust constrainedby Interfaces.ThrustLaw "Law of the thrust" annotation (choicesAllMatching = true);
  replaceable model DragLaw = Aerodynamics.QuadraticDrag constrainedby Interfaces.DragLaw "Law of the drag torque" annotation (choicesAllMatching = true);
  input Real V_m(unit = "V", min = -24, max = 24) "Voltage of the main motor" annotation (Placement(transformation(extent = {{-120, 50}, {-100, 70}})));
  input Real V_t(unit = "V", min = -24, max = 24) "Voltage of the tail motor" annotation (Placement(transformation(extent = {{-120, -70}, {-100, -50}})));
  output Real omega_m(unit = "rad/s") "Speed of the main motor" annotation (Placement(transformation(extent = {{100, 70}, {120, 90}})));
  output Real omega_t(unit = "rad/s") "Speed of the tail motor" annotation (Placement(transformation(extent = {{100, -90}, {120, -70}})));
  output Real theta(unit = "rad") "Pitch angle" annotation (Placement(transformation(extent = {{100, -30}, {120, -10}})));
  output Real psi(unit = "rad") "Yaw angle" annotation (Placement(transformation(extent = {{100, 10}, {120, 30}})));
  Aerodynamics.FreeThruster thruster_m(R_a = R_a, L_a = L_a, c_m = c_m, J_r = J_r, J_s = J_s, k_t = k_t, k_d = k_d, final orientation = 1, final hand = 1, u = V_m,
    redeclare model ThrustLaw = ThrustLaw, redeclare model DragLaw = DragLaw)
    annotation (Placement(transformation(extent = {{-80, 50}, {-60, 70}})));
  Aerodynamics.FreeThruster thruster_t(R_a = R_a, L_a = L_a, c_m = c_m, J_r = J_r, J_s = J_s, k_t = k_tt, k_d = k_dt, final orientation = 1, final hand = -1, u = V_t,
    redeclare model ThrustLaw = ThrustLaw, redeclare model DragLaw = DragLaw)
    annotation (Placement(transformation(extent = {{-80, -70}, {-60, -50}})));
  Mechanical.Lever arm_m(r = D_t, f = thruster_m.f) annotation (Placement(transformation(extent = {{-30, 60}, {-10, 80}})));
  Mechanical.TiltingLever arm_t(r = D_t, f = thruster_t.f, theta = body.theta) annotation (Placement(transformation(extent = {{-30, -70}, {-10, -50}})));
  Mechanical.TiltingAxis axis_m(theta = body.theta, H = thruster_m.H) annotation (Placement(transformation(extent = {{-30, 20}, {-10, 40}})));
  Mechanical.PitchYawBody body(J_p = J_p, J_y = J_y, D_p = D_p, D_y = D_y, K_sp = K_sp) annotation (Placement(transformation(extent = {{40, -10}, {60, 10}})));
equation
  connect(arm_m.flange, body.pitch) annotation (Line(points = {{-10, 70}, {20, 70}, {20, -5}, {40, -5}}, color = {60, 60, 60}));
  connect(thruster_m.housing, axis_m.housing) annotation (Line(points = {{-70, 50}, {-70, 30}, {-30, 30}}, color = {60, 60, 60}));
  connect(axis_m.pitch, body.pitch) annotation (Line(points = {{-10, 25}, {20, 25}, {20, -5}, {40, -5}}, color = {60, 60, 60}));
  connect(axis_m.yaw, body.yaw) annotation (Line(points = {{-10, 35}, {30, 35}, {30, 5}, {40, 5}}, color = {60, 60, 60}));
  connect(arm_t.flange, body.yaw) annotation (Line(points = {{-10, -60}, {30, -60}, {30, 5}, {40, 5}}, color = {60, 60, 60}));
  connect(thruster_t.housing, body.pitch) annotation (Line(points = {{-70, -70}, {-70, -80}, {20, -80}, {20, -5}, {40, -5}}, color = {60, 60, 60}));
  omega_m = thruster_m.motor.rotor.w;
  omega_t = thruster_t.motor.rotor.w;
  theta = body.theta;
  psi = body.psi;
  annotation (
    experiment(StartTime = 0, StopTime = 35, Tolerance = 1e-6),
    Documentation(info = "<html><p>The main propeller pushes upward at one end of the body, the tail propeller sideways at the other; its axis is parallel to the pitch axis.
Positive <code>V_m</code> pitches the body up and positive <code>V_t</code> yaws it to positive angles. The cross torques are what turns the rotors, pushed back on
the body: the main motor's yaws it to negative angles, by the cosine of the pitch, and the tail motor's pitches it up. The main rotor, tilted by the pitch, couples
both axes as a gyroscope; the tail rotor keeps the direction of the pitch axis and does not. Eight states.</p>
<p>Speeds, angles and voltages do not tell <code>R_a</code> from the motor's other constants, and only ratios to <code>J_p</code> show: hold <code>J_p</code>,
<code>D_t</code>, <code>J_s</code> and <code>L_a</code>.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Rectangle(extent = {{-100, 100}, {100, -100}}, lineColor = {60, 60, 60}, fillColor = {255, 255, 255}, fillPattern = FillPattern.Solid),
      Polygon(points = {{0, 10}, {-20, -60}, {20, -60}, {0, 10}}, lineColor = {95, 95, 95}, fillColor = {180, 190, 205}, fillPattern = FillPattern.Solid),
      Line(points = {{-70, -10}, {70, 30}}, color = {40, 80, 140}, thickness = 2),
      Ellipse(extent = {{45, 38}, {95, 24}}, lineColor = {0, 110, 60}), Ellipse(extent = {{-78, 15}, {-62, -35}}, lineColor = {0, 110, 60}),
      Ellipse(extent = {{-40, -64}, {40, -84}}, lineColor = {40, 80, 140}),
      Text(extent = {{-150, 150}, {150, 110}}, textString = "%name")}));
end TwoDof;
