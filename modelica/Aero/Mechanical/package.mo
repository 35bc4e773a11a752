within Aero;
package Mechanical "Rotor inertia, thruster arm and pitching body"
  annotation (
    Documentation(info = "<html><p>Rotational parts with speed-and-torque flanges, and the lever that turns a thrust into a torque.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Rectangle(extent = {{-100, 100}, {100, -100}}, lineColor = {95, 95, 95}, fillColor = {245, 245, 245}, fillPattern = FillPattern.Solid, radius = 15),
      Ellipse(extent = {{-60, 60}, {60, -60}}, lineColor = {60, 60, 60}, fillColor = {200, 210, 225}, fillPattern = FillPattern.Solid)}));
end Mechanical;
