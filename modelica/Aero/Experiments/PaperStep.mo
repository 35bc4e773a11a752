within Aero.Experiments;
model PaperStep "24 V for 20 s, then 0 V for 20 s"
  Systems.OneDof bench(V_m = if time < 20 then 24 else 0);
  annotation (
    experiment(StartTime = 0, StopTime = 40, Tolerance = 1e-6),
    Documentation(info = "<html><p>The experiment of the paper's section V.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Polygon(points = {{-60, 80}, {80, 0}, {-60, -80}, {-60, 80}}, lineColor = {60, 120, 60}, fillColor = {120, 180, 120}, fillPattern = FillPattern.Solid)}));
end PaperStep;
