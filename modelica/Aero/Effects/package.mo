within Aero;
package Effects "Laws that the general ones do not say"
  annotation (
    Documentation(info = "<html><p>Each extends a partial model of <code>Laws.Interfaces</code> and vanishes where its parameter is zero. <code>package.toml</code> names the places of these
and of the general laws.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Rectangle(extent = {{-100, 100}, {100, -100}}, lineColor = {95, 95, 95}, fillColor = {245, 245, 245}, fillPattern = FillPattern.Solid, radius = 15),
      Rectangle(extent = {{-60, 40}, {60, -40}}, lineColor = {60, 60, 60}, fillColor = {255, 248, 220}, fillPattern = FillPattern.Solid)}));
end Effects;
