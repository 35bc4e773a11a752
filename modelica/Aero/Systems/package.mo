within Aero;
package Systems "Assembled benches"
  annotation (
    Documentation(info = "<html><p>Input <code>V_m</code>, outputs <code>i_m</code>, <code>omega_m</code>, <code>theta</code>, parameters named as in the paper; <code>TwoDof</code> has two
voltages, two speeds and two angles.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Rectangle(extent = {{-100, 100}, {100, -100}}, lineColor = {95, 95, 95}, fillColor = {245, 245, 245}, fillPattern = FillPattern.Solid, radius = 15),
      Line(points = {{-70, -10}, {70, 30}}, color = {40, 80, 140}, thickness = 2),
      Polygon(points = {{0, 10}, {-20, -60}, {20, -60}, {0, 10}}, lineColor = {95, 95, 95}, fillColor = {180, 190, 205}, fillPattern = FillPattern.Solid)}));
end Systems;
