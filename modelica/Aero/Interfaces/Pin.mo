within Aero.Interfaces;
connector Pin "Electrical pin"
  Real v(unit = "V") "Potential";
  flow Real i(unit = "A") "Current into the component";
  annotation (
    Documentation(info = "<html><p>Potential and current. At a connection potentials are equal and currents sum to zero.</p></html>"),
    Icon(graphics = {Rectangle(extent = {{-100, 100}, {100, -100}}, lineColor = {0, 0, 200}, fillColor = {0, 0, 200}, fillPattern = FillPattern.Solid)}));
end Pin;
