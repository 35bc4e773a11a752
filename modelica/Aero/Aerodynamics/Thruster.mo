within Aero.Aerodynamics;
model Thruster "Amplifier, motor and propeller"
  parameter Real R_a(unit = "Ohm", nominal = 10) = 8.4 "Armature resistance of the motor";
  parameter Real L_a(unit = "H", nominal = 1e-3) = 1.16e-3 "Armature inductance of the motor";
  parameter Real c_m(unit = "N.m/A", nominal = 0.05) = 0.042 "Mechanical torque constant of the motor";
  parameter Real J_r(unit = "kg.m2", nominal = 1e-5) = 4e-6 "Moment of inertia of the motor's rotor";
  parameter Real J_s(unit = "kg.m2", nominal = 1e-5) = 4e-6 "Moment of inertia of the stator's part that turns along";
  parameter Real k_t = 2.9e-7 "Thrust coefficient; its unit follows from the law";
  parameter Real k_d = 2.4e-8 "Drag coefficient; its unit follows from the law";
  parameter Real orientation = 1 "1 where positive thrust pitches the body up, -1 where it pitches it down";
  replaceable model ThrustLaw = QuadraticThrust constrainedby Interfaces.ThrustLaw "Law of the thrust" annotation (choicesAllMatching = true);
  replaceable model DragLaw = QuadraticDrag constrainedby Interfaces.DragLaw "Law of the drag torque" annotation (choicesAllMatching = true);
  input Real u(unit = "V") "Commanded voltage";
  Interfaces.ForceOutput f "Thrust, counted where it pitches the body up" annotation (Placement(transformation(extent = {{90, -10}, {110, 10}})));
  Electrical.Amplifier amplifier(u = u) annotation (Placement(transformation(extent = {{-100, -10}, {-80, 10}})));
  Electrical.Ground ground annotation (Placement(transformation(extent = {{-80, -50}, {-60, -30}})));
  Electrical.DCMotor motor(R_a = R_a, L_a = L_a, c_m = c_m, J_r = J_r, J_s = J_s) annotation (Placement(transformation(extent = {{-20, -10}, {0, 10}})));
  Propeller propeller(k_t = k_t, k_d = k_d, redeclare model ThrustLaw = ThrustLaw, redeclare model DragLaw = DragLaw)
    annotation (Placement(transformation(extent = {{20, -10}, {40, 10}})));
equation
  connect(amplifier.p, motor.p) annotation (Line(points = {{-80, 5}, {-20, 5}}, color = {0, 0, 200}));
  connect(amplifier.n, ground.p) annotation (Line(points = {{-80, -5}, {-70, -5}, {-70, -30}}, color = {0, 0, 200}));
  connect(motor.n, ground.p) annotation (Line(points = {{-20, -5}, {-30, -5}, {-30, -30}, {-70, -30}}, color = {0, 0, 200}));
  connect(motor.flange, propeller.flange) annotation (Line(points = {{0, 0}, {20, 0}}, color = {60, 60, 60}));
  f = orientation * propeller.f;
  annotation (
    Documentation(info = "<html><p>One channel of the bench.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Rectangle(extent = {{-90, 40}, {20, -40}}, lineColor = {60, 60, 60}, fillColor = {200, 210, 225}, fillPattern = FillPattern.HorizontalCylinder),
      Line(points = {{20, 0}, {90, 0}}, color = {60, 60, 60}),
      Ellipse(extent = {{35, 90}, {65, 0}}, lineColor = {0, 110, 60}, fillColor = {200, 225, 210}, fillPattern = FillPattern.Solid),
      Ellipse(extent = {{35, 0}, {65, -90}}, lineColor = {0, 110, 60}, fillColor = {200, 225, 210}, fillPattern = FillPattern.Solid),
      Text(extent = {{-150, 140}, {150, 100}}, textString = "%name")}));
end Thruster;
