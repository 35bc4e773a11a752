within Aero.Electrical;
model DCMotor "Permanent-magnet DC motor"
  parameter Real R_a(unit = "Ohm", nominal = 10) = 8.4 "Armature resistance";
  parameter Real L_a(unit = "H", nominal = 1e-3) = 1.16e-3 "Armature inductance";
  parameter Real c_m(unit = "N.m/A", nominal = 0.05) = 0.042 "Mechanical torque constant, also the back-EMF constant in V.s/rad";
  parameter Real J_r(unit = "kg.m2", nominal = 1e-5) = 4e-6 "Moment of inertia of the rotor";
  parameter Real J_s(unit = "kg.m2", nominal = 1e-5) = 4e-6 "Moment of inertia of the stator's part that turns along";
  parameter Real J_t(unit = "kg.m2", nominal = 1e-5) = J_r + J_s "Total moment of inertia";
  Interfaces.Pin p annotation (Placement(transformation(extent = {{-110, 40}, {-90, 60}})));
  Interfaces.Pin n annotation (Placement(transformation(extent = {{-110, -60}, {-90, -40}})));
  Interfaces.Flange flange "Shaft" annotation (Placement(transformation(extent = {{90, -10}, {110, 10}})));
  Resistor resistor(R = R_a) annotation (Placement(transformation(extent = {{-80, 40}, {-60, 60}})));
  Inductor inductor(L = L_a) annotation (Placement(transformation(extent = {{-50, 40}, {-30, 60}})));
  RotationalEMF emf(c = c_m) annotation (Placement(transformation(extent = {{-10, -10}, {10, 10}})));
  Mechanical.Inertia rotor(J = J_t) annotation (Placement(transformation(extent = {{40, -10}, {60, 10}})));
equation
  connect(p, resistor.p) annotation (Line(points = {{-100, 50}, {-80, 50}}, color = {0, 0, 200}));
  connect(resistor.n, inductor.p) annotation (Line(points = {{-60, 50}, {-50, 50}}, color = {0, 0, 200}));
  connect(inductor.n, emf.p) annotation (Line(points = {{-30, 50}, {-20, 50}, {-20, 0}, {-10, 0}}, color = {0, 0, 200}));
  connect(emf.n, n) annotation (Line(points = {{0, -10}, {0, -50}, {-100, -50}}, color = {0, 0, 200}));
  connect(emf.flange, rotor.flange_a) annotation (Line(points = {{10, 0}, {40, 0}}, color = {60, 60, 60}));
  connect(rotor.flange_b, flange) annotation (Line(points = {{60, 0}, {100, 0}}, color = {60, 60, 60}));
  annotation (
    Documentation(info = "<html><p>The paper's Eqs. 1 to 3:</p>
<pre>V_m = R_a i + L_a di/dt + c_m w
(J_r + J_s) dw/dt = c_m i - load</pre>
<p>Only the sum of the two inertias acts; both are kept because the paper tunes both.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Rectangle(extent = {{-70, 60}, {60, -60}}, lineColor = {60, 60, 60}, fillColor = {200, 210, 225}, fillPattern = FillPattern.HorizontalCylinder),
      Rectangle(extent = {{60, 10}, {90, -10}}, lineColor = {60, 60, 60}, fillColor = {170, 170, 170}, fillPattern = FillPattern.HorizontalCylinder),
      Line(points = {{-90, 50}, {-70, 50}}, color = {0, 0, 200}), Line(points = {{-90, -50}, {-70, -50}}, color = {0, 0, 200}),
      Text(extent = {{-150, 110}, {150, 70}}, textString = "%name")}));
end DCMotor;
