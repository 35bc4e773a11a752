within Aero.Interfaces;
connector Mount "Translational mount with velocity and force"
  Real v(unit = "m/s") "Velocity along the propeller's axis";
  flow Real f(unit = "N") "Force into the component";
  annotation (
    Documentation(info = "<html><p>Where a propeller is bolted to what it pushes.</p></html>"),
    Icon(graphics = {Rectangle(extent = {{-100, 100}, {100, -100}}, lineColor = {0, 110, 60}, fillColor = {0, 150, 80}, fillPattern = FillPattern.Solid)}));
end Mount;
