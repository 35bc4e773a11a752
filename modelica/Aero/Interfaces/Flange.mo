within Aero.Interfaces;
connector Flange "Rotational flange with speed and torque"
  Real w(unit = "rad/s") "Angular velocity";
  flow Real tau(unit = "N.m") "Torque into the component";
  annotation (
    Documentation(info = "<html><p>A shaft's end. It carries the speed and not the angle, so that a rotor whose angle nothing measures needs one
state and not two.</p></html>"),
    Icon(graphics = {Ellipse(extent = {{-100, 100}, {100, -100}}, lineColor = {60, 60, 60}, fillColor = {140, 140, 140}, fillPattern = FillPattern.Solid)}));
end Flange;
