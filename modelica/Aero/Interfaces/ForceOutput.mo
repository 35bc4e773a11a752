within Aero.Interfaces;
connector ForceOutput = output Real(unit = "N") "Thrust of a propeller, given to what carries it"
  annotation (
    Documentation(info = "<html><p>The thrust as a signal, so that a law can act on it between the propeller and its arm.</p></html>"),
    Icon(graphics = {Polygon(points = {{-100, 100}, {100, 0}, {-100, -100}}, lineColor = {0, 110, 60}, fillColor = {255, 255, 255}, fillPattern = FillPattern.Solid)}));
