within ;
package Aero "Twin-rotor bench (Quanser AERO): DC motors, propellers and a pitching body"
  annotation (
    version = "1.0.0",
    Documentation(info = "<html>
<p>An acausal model library of the Quanser AERO, a bench with two propellers on a pivoted body. It follows the
multi-domain model of the paper <i>Parameter Optimization and Model Validation of Quanser AERO using Modelica and
RaPIId</i> (Eqs. 1 to 5) and its models need no other library.</p>
<ul>
<li><b>Interfaces</b>: connectors, and the partial models of the propeller's laws.</li>
<li><b>Electrical</b>, <b>Mechanical</b>, <b>Aerodynamics</b>: the components.</li>
<li><b>Effects</b>: laws of the AERO alone, which extend those of <code>Laws.Interfaces</code>; the others that its models may lack are in the package <code>Laws</code>.</li>
<li><b>Systems</b>: assembled benches with input <code>V_m</code> and outputs <code>i_m</code>, <code>omega_m</code>, <code>theta</code>, and one free in pitch and yaw.</li>
<li><b>Experiments</b>: ready-to-run set-ups.</li>
</ul>
<p>Rotational flanges carry speed and torque (<code>w</code>, flow <code>tau</code>). An angle would add states that nothing measures.
All quantities are in SI units.</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Rectangle(extent = {{-100, 100}, {100, -100}}, lineColor = {95, 95, 95}, fillColor = {245, 245, 245}, fillPattern = FillPattern.Solid, radius = 15),
      Line(points = {{-70, -10}, {70, 30}}, color = {40, 80, 140}, thickness = 2),
      Polygon(points = {{0, 10}, {-20, -60}, {20, -60}, {0, 10}}, lineColor = {95, 95, 95}, fillColor = {180, 190, 205}, fillPattern = FillPattern.Solid),
      Ellipse(extent = {{-95, 2}, {-45, -12}}, lineColor = {40, 80, 140}),
      Ellipse(extent = {{45, 38}, {95, 24}}, lineColor = {40, 80, 140})}));
end Aero;
