within Aero.Systems;
partial model Bench "One driven thruster on a pitching body; what all benches share"
  parameter Real R_a(unit = "Ohm", min = 0.1, max = 100, nominal = 8.4) = 8.4 "Armature resistance of a motor";
  parameter Real L_a(unit = "H", min = 1e-5, max = 0.1, nominal = 1.16e-3) = 1.16e-3 "Armature inductance of a motor";
  parameter Real c_m(unit = "N.m/A", min = 1e-3, max = 1, nominal = 0.042) = 0.042 "Mechanical torque constant of a motor, also its back-EMF constant in V.s/rad";
  parameter Real J_r(unit = "kg.m2", min = 1e-8, max = 1e-3, nominal = 4e-6) = 4e-6 "Moment of inertia of a motor's rotor";
  parameter Real J_s(unit = "kg.m2", min = 0, max = 1e-3, nominal = 4e-6) = 4e-6 "Moment of inertia of a motor's stator part that turns along";
  parameter Real k_d(unit = "N.m.s2/rad2", min = 0, max = 1e-5, nominal = 2.4e-8) = 2.4e-8 "Aerodynamic drag coefficient of a propeller";
  parameter Real k_t(unit = "N.s2/rad2", min = 0, max = 1e-3, nominal = 2.9e-7) = 2.9e-7 "Aerodynamic thrust coefficient of a propeller";
  parameter Real J_p(unit = "kg.m2", min = 1e-4, max = 1, nominal = 0.0219) = 0.0219 "Moment of inertia of the body about the pitch axis";
  parameter Real D_p(unit = "N.m.s/rad", min = 0, max = 1, nominal = 0.0071) = 0.0071 "Viscous damping of the body about the pitch axis";
  parameter Real K_sp(unit = "N.m/rad", min = 1e-4, max = 10, nominal = 0.0375) = 0.0375 "Stiffness of the body about the pitch axis";
  parameter Real D_t(unit = "m", min = 0.01, max = 1, nominal = 0.158) = 0.158 "Distance of a thruster from the pitch axis";
  replaceable model ThrustLaw = Aerodynamics.QuadraticThrust constrainedby Interfaces.ThrustLaw "Law of the thrust" annotation (choicesAllMatching = true);
  replaceable model DragLaw = Aerodynamics.QuadraticDrag constrainedby Interfaces.DragLaw "Law of the drag torque" annotation (choicesAllMatching = true);
  input Real V_m(unit = "V") "Motor voltage" annotation (Placement(transformation(extent = {{-120, -10}, {-100, 10}})));
  output Real i_m(unit = "A") "Current through motor 1" annotation (Placement(transformation(extent = {{100, 50}, {120, 70}})));
  output Real omega_m(unit = "rad/s") "Speed of motor 1" annotation (Placement(transformation(extent = {{100, -10}, {120, 10}})));
  output Real theta(unit = "rad") "Pitch angle" annotation (Placement(transformation(extent = {{100, -70}, {120, -50}})));
  Aerodynamics.Thruster thruster_1(R_a = R_a, L_a = L_a, c_m = c_m, J_r = J_r, J_s = J_s, k_t = k_t, k_d = k_d, final orientation = 1, u = V_m,
    redeclare model ThrustLaw = ThrustLaw, redeclare model DragLaw = DragLaw)
    annotation (Placement(transformation(extent = {{-80, 30}, {-60, 50}})));
  Mechanical.Lever arm_1(r = D_t, w = thruster_1.motor.rotor.w) annotation (Placement(transformation(extent = {{-40, 30}, {-20, 50}})));
  Mechanical.PitchingBody body(J_p = J_p, D_p = D_p, K_sp = K_sp) annotation (Placement(transformation(extent = {{20, -10}, {40, 10}})));
equation
  connect(thruster_1.f, arm_1.f) annotation (Line(points = {{-60, 40}, {-40, 40}}, color = {0, 110, 60}));
  connect(arm_1.flange, body.flange) annotation (Line(points = {{-20, 40}, {0, 40}, {0, 0}, {20, 0}}, color = {60, 60, 60}));
  i_m = thruster_1.motor.inductor.i;
  omega_m = thruster_1.motor.rotor.w;
  theta = body.theta;
  annotation (
    Documentation(info = "<html><p>Motor 1 pitches the body up at positive <code>V_m</code>. Extended by <code>HalfQuad</code>, which adds nothing, and by
<code>OneDof</code>, which adds the second thruster.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Rectangle(extent = {{-100, 100}, {100, -100}}, lineColor = {60, 60, 60}, fillColor = {255, 255, 255}, fillPattern = FillPattern.Solid),
      Line(points = {{-70, -10}, {70, 30}}, color = {40, 80, 140}, thickness = 2),
      Polygon(points = {{0, 10}, {-20, -60}, {20, -60}, {0, 10}}, lineColor = {95, 95, 95}, fillColor = {180, 190, 205}, fillPattern = FillPattern.Solid),
      Text(extent = {{-150, 150}, {150, 110}}, textString = "%name")}));
end Bench;
