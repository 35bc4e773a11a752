within Aero.Effects;
model IdealSensor "Reading equal to the quantity"
  extends Interfaces.Sensor;
equation
  y = u;
  annotation (Documentation(info = "<html><p>Neither offset nor lag.</p></html>"));
end IdealSensor;
