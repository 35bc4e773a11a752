within Aero;
package Interfaces "Connectors and partial models"
  annotation (
    Documentation(info = "<html>
<p>Three physical connectors (<code>Pin</code>, <code>Flange</code>, <code>Mount</code>), the partial models of the propeller's laws, and one
partial model for each <b>port</b> at which physics can be added to a system of <code>Aero.Systems</code>:</p>
<table border=\"1\"><tr><th>port</th><th>partial model</th><th>acts</th></tr>
<tr><td>electrical</td><td>ElectricalEffect</td><td>in series between an amplifier and its motor</td></tr>
<tr><td>rotor</td><td>RotorEffect</td><td>as a torque on a rotor's shaft</td></tr>
<tr><td>thrust</td><td>ThrustEffect</td><td>between a propeller and the body that carries it</td></tr>
<tr><td>body</td><td>BodyEffect</td><td>as a torque at the body's pivot</td></tr>
<tr><td>sensor</td><td>Sensor</td><td>between a quantity and its reading</td></tr></table>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Rectangle(extent = {{-100, 100}, {100, -100}}, lineColor = {95, 95, 95}, fillColor = {245, 245, 245}, fillPattern = FillPattern.Solid, radius = 15),
      Ellipse(extent = {{-60, 30}, {0, -30}}, lineColor = {95, 95, 95}, fillColor = {255, 255, 255}, fillPattern = FillPattern.Solid),
      Rectangle(extent = {{0, 30}, {60, -30}}, lineColor = {95, 95, 95}, fillColor = {180, 190, 205}, fillPattern = FillPattern.Solid)}));
end Interfaces;
