within Laws.Storage;
model Offset "A constant loss"
  extends Laws.Interfaces.StorageLaw;
  parameter Real q_0(min = -10 * q_n, max = 10 * q_n, nominal = 0.1 * q_n) = 0 "Loss whatever the level";
equation
  q = q_0;
  annotation (Documentation(info = "<html>
<p>A second consumer, a valve that does not shut, a bias current, sunshine (negative).</p>
<p>Source: R. Isermann, Fault-Diagnosis Systems (Springer, 2006), ch. 5: additive faults of processes.</p>
</html>"));
end Offset;
