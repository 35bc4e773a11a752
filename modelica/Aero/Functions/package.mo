within Aero;
package Functions "Shapes of curves"
  annotation (
    Documentation(info = "<html><p>Functions that the components share.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Rectangle(extent = {{-100, 100}, {100, -100}}, lineColor = {95, 95, 95}, fillColor = {245, 245, 245}, fillPattern = FillPattern.Solid, radius = 15),
      Text(extent = {{-60, 60}, {60, -60}}, textString = "f")}));
end Functions;
