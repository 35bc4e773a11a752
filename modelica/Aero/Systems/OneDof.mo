within Aero.Systems;
model OneDof "One-degree-of-freedom set-up: both motors driven against each other, the body free in pitch"
  extends Bench;
  Aerodynamics.Thruster thruster_2(R_a = R_a, L_a = L_a, c_m = c_m, J_r = J_r, J_s = J_s, k_t = k_t, k_d = k_d, final orientation = -1, u = -V_m,
    redeclare model ThrustLaw = ThrustLaw, redeclare model DragLaw = DragLaw)
    annotation (Placement(transformation(extent = {{-80, -50}, {-60, -30}})));
  Mechanical.Lever arm_2(r = D_t, w = thruster_2.motor.rotor.w) annotation (Placement(transformation(extent = {{-40, -50}, {-20, -30}})));
equation
  connect(thruster_2.f, arm_2.f) annotation (Line(points = {{-60, -40}, {-40, -40}}, color = {0, 110, 60}));
  connect(arm_2.flange, body.flange) annotation (Line(points = {{-20, -40}, {0, -40}, {0, 0}, {20, 0}}, color = {60, 60, 60}));
  annotation (
    experiment(StartTime = 0, StopTime = 40, Tolerance = 1e-6),
    Documentation(info = "<html><p>Motor 1 is driven at <code>V_m</code> and motor 2, on the other arm, at <code>-V_m</code>, so that both thrusters pitch the body the
same way (the configuration of the paper's Fig. 1). Six states. <code>i_m</code> and <code>omega_m</code> are those of motor 1.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Ellipse(extent = {{-95, 2}, {-45, -12}}, lineColor = {0, 110, 60}), Ellipse(extent = {{45, 38}, {95, 24}}, lineColor = {0, 110, 60})}));
end OneDof;
