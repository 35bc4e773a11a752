within Aero;
package Electrical "Amplifier and DC motor"
  annotation (
    Documentation(info = "<html><p>The circuit of the paper's Eqs. 1 to 3.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Rectangle(extent = {{-100, 100}, {100, -100}}, lineColor = {95, 95, 95}, fillColor = {245, 245, 245}, fillPattern = FillPattern.Solid, radius = 15),
      Line(points = {{-80, 0}, {-50, 0}}, color = {0, 0, 200}), Line(points = {{50, 0}, {80, 0}}, color = {0, 0, 200}),
      Rectangle(extent = {{-50, 20}, {50, -20}}, lineColor = {0, 0, 200}, fillColor = {255, 255, 255}, fillPattern = FillPattern.Solid)}));
end Electrical;
