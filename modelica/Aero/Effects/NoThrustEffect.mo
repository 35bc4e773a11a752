within Aero.Effects;
model NoThrustEffect "The whole thrust reaches the body"
  extends Interfaces.ThrustEffect;
equation
  propeller.v = frame.v;
  propeller.f + frame.f = 0;
  annotation (Documentation(info = "<html><p>A rigid, lossless mount.</p></html>"));
end NoThrustEffect;
