within Laws.Inputs;
model Offset "An input that is off by a constant"
  extends Laws.Interfaces.InputLaw;
  parameter Real b(min = -10 * u_n, max = 10 * u_n, nominal = 0.1 * u_n) = 0 "Offset of the input";
equation
  y = u + b;
  annotation (Documentation(info = "<html>
<p>A bias of the actuator or of what drives it.</p>
<p>Source: R. Isermann, Fault-Diagnosis Systems (Springer, 2006), ch. 5: additive faults of actuators.</p>
</html>"));
end Offset;
