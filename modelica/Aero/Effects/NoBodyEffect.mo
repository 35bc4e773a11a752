within Aero.Effects;
model NoBodyEffect "No torque at the pivot"
  extends Interfaces.BodyEffect;
equation
  flange.tau = 0;
  annotation (Documentation(info = "<html><p>An ideal pivot.</p></html>"));
end NoBodyEffect;
