within Aero.Systems;
model TransferFunction "Linear voltage-to-pitch model that Quanser provides"
  parameter Real K_pp(unit = "N.m/V", min = 1e-5, max = 1, nominal = 0.0011) = 0.0011 "Torque about the pitch axis for each volt of motor voltage";
  parameter Real J_p(unit = "kg.m2", min = 1e-4, max = 1, nominal = 0.0219) = 0.0219 "Moment of inertia of the body about the pitch axis";
  parameter Real D_p(unit = "N.m.s/rad", min = 0, max = 1, nominal = 0.0071) = 0.0071 "Viscous damping of the body about the pitch axis";
  parameter Real K_sp(unit = "N.m/rad", min = 1e-4, max = 10, nominal = 0.0375) = 0.0375 "Stiffness of the body about the pitch axis";
  input Real V_m(unit = "V") "Motor voltage" annotation (Placement(transformation(extent = {{-120, -10}, {-100, 10}})));
  output Real theta(unit = "rad") "Pitch angle" annotation (Placement(transformation(extent = {{100, -10}, {120, 10}})));
  Mechanical.Torque thrusters(tau = K_pp * V_m) annotation (Placement(transformation(extent = {{-60, -10}, {-40, 10}})));
  Mechanical.PitchingBody body(J_p = J_p, D_p = D_p, K_sp = K_sp) annotation (Placement(transformation(extent = {{0, -10}, {20, 10}})));
equation
  connect(thrusters.flange, body.flange) annotation (Line(points = {{-40, 0}, {0, 0}}, color = {60, 60, 60}));
  theta = body.theta;
  annotation (
    experiment(StartTime = 0, StopTime = 40, Tolerance = 1e-6),
    Documentation(info = "<html><p><code>J_p theta'' + D_p theta' + K_sp theta = K_pp V_m</code>: the motors are taken as instantaneous and the thrust as proportional to the
voltage.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Rectangle(extent = {{-100, 100}, {100, -100}}, lineColor = {60, 60, 60}, fillColor = {255, 255, 255}, fillPattern = FillPattern.Solid),
      Line(points = {{-60, 0}, {60, 0}}, color = {60, 60, 60}),
      Text(extent = {{-60, 50}, {60, 10}}, textString = "K"), Text(extent = {{-80, -10}, {80, -50}}, textString = "J s^2+D s+K"),
      Text(extent = {{-150, 150}, {150, 110}}, textString = "%name")}));
end TransferFunction;
