within Laws.Inputs;
model Gain "An input whose effect is stronger or weaker than stated"
  extends Laws.Interfaces.InputLaw;
  parameter Real g(min = -0.95, max = 9, nominal = 0.1) = 0 "Relative error of the gain";
equation
  y = (1 + g) * u;
  annotation (Documentation(info = "<html>
<p>The first correction of any actuator. Only where the model's own factor on this input is fixed does it say anything new.</p>
<p>Source: R. Isermann, Fault-Diagnosis Systems (Springer, 2006), ch. 5: multiplicative faults of actuators.</p>
</html>"));
end Gain;
