within Aero.Effects;
model NoRotorEffect "No torque on the rotor's shaft"
  extends Interfaces.RotorEffect;
equation
  flange.tau = 0;
  annotation (Documentation(info = "<html><p>A free shaft end.</p></html>"));
end NoRotorEffect;
