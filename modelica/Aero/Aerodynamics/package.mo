within Aero;
package Aerodynamics "Propeller laws, propeller and thruster"
  annotation (
    Documentation(info = "<html><p>The paper's Eqs. 4 and 5 are quadratic in the speed; the units and sizes of its Table 1 fit a linear law only. Both are here,
each with its own units.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Rectangle(extent = {{-100, 100}, {100, -100}}, lineColor = {95, 95, 95}, fillColor = {245, 245, 245}, fillPattern = FillPattern.Solid, radius = 15),
      Ellipse(extent = {{-80, 15}, {0, -15}}, lineColor = {0, 110, 60}, fillColor = {200, 225, 210}, fillPattern = FillPattern.Solid),
      Ellipse(extent = {{0, 15}, {80, -15}}, lineColor = {0, 110, 60}, fillColor = {200, 225, 210}, fillPattern = FillPattern.Solid)}));
end Aerodynamics;
