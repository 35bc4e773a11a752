within Aero;
package Interfaces "Connectors and partial models"
  annotation (
    Documentation(info = "<html>
<p>Two physical connectors (<code>Pin</code>, <code>Flange</code>), those of a force as a signal, and the partial models of the propeller's laws.</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Rectangle(extent = {{-100, 100}, {100, -100}}, lineColor = {95, 95, 95}, fillColor = {245, 245, 245}, fillPattern = FillPattern.Solid, radius = 15),
      Ellipse(extent = {{-60, 30}, {0, -30}}, lineColor = {95, 95, 95}, fillColor = {255, 255, 255}, fillPattern = FillPattern.Solid),
      Rectangle(extent = {{0, 30}, {60, -30}}, lineColor = {95, 95, 95}, fillColor = {180, 190, 205}, fillPattern = FillPattern.Solid)}));
end Interfaces;
