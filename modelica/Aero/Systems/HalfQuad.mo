within Aero.Systems;
model HalfQuad "Half-quadrotor set-up: one motor driven, the other at rest"
  extends Bench;
  annotation (
    experiment(StartTime = 0, StopTime = 30, Tolerance = 1e-6),
    Documentation(info = "<html><p>Motor 1 is driven at <code>V_m</code>; motor 2 stands still and is part of the body's inertia, so that it has no states.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Ellipse(extent = {{45, 38}, {95, 24}}, lineColor = {0, 110, 60})}));
end HalfQuad;
