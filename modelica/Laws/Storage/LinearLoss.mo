within Laws.Storage;
model LinearLoss "Loss in proportion to the level"
  extends Laws.Interfaces.StorageLaw;
  parameter Real k(min = 0, max = 10 * q_n / h_n, nominal = 0.1 * q_n / h_n) = 0 "Loss for each unit of level";
equation
  q = k * (h - h_s);
  annotation (Documentation(info = "<html>
<p>Laminar seepage, a leak resistance, heat lost to the surroundings at <code>h_s</code>.</p>
<p>Source: I. Newton, Scala graduum caloris, Philosophical Transactions 22 (1701); J. L. M. Poiseuille (1840).</p>
</html>"));
end LinearLoss;
