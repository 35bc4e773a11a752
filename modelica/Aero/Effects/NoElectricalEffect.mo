within Aero.Effects;
model NoElectricalEffect "Nothing between amplifier and motor"
  extends Interfaces.ElectricalEffect;
equation
  p.v = n.v;
  p.i + n.i = 0;
  r.i = 0;
  annotation (Documentation(info = "<html><p>A wire.</p></html>"));
end NoElectricalEffect;
