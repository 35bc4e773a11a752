within Aero.Experiments;
model HalfQuadStep "One motor driven by a step"
  parameter Real V(unit = "V") = 16.5 "Height of the step at t = 0";
  Systems.HalfQuad bench(V_m = V);
  annotation (
    experiment(StartTime = 0, StopTime = 30, Tolerance = 1e-6),
    Documentation(info = "<html><p>A step of the motor voltage on the half-quadrotor set-up.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Polygon(points = {{-60, 80}, {80, 0}, {-60, -80}, {-60, 80}}, lineColor = {60, 120, 60}, fillColor = {120, 180, 120}, fillPattern = FillPattern.Solid)}));
end HalfQuadStep;
