within Aero;
package Experiments "Ready-to-run set-ups"
  annotation (
    Documentation(info = "<html><p>For a simulation environment: each drives one of <code>Aero.Systems</code> with a voltage of its own.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Rectangle(extent = {{-100, 100}, {100, -100}}, lineColor = {95, 95, 95}, fillColor = {245, 245, 245}, fillPattern = FillPattern.Solid, radius = 15),
      Polygon(points = {{-40, 60}, {60, 0}, {-40, -60}, {-40, 60}}, lineColor = {60, 120, 60}, fillColor = {120, 180, 120}, fillPattern = FillPattern.Solid)}));
end Experiments;
