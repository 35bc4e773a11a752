within Laws.Storage;
model RootLoss "Loss by the root of the level"
  extends Laws.Interfaces.StorageLaw;
  parameter Real k(min = 0, max = 10 * q_n / sqrt(h_n), nominal = 0.1 * q_n / sqrt(h_n)) = 0 "Loss at a level of one above the surroundings";
protected
  final parameter Real h_smooth = 1e-3 * h_n "Level below which the root is rounded";
equation
  q = k * (h - h_s) / sqrt(sqrt((h - h_s) ^ 2 + h_smooth ^ 2));
  annotation (__aero_bayes(not_for = "K A", nonnegative = "h"),
    Documentation(info = "<html>
<p>Outflow through a hole at the level <code>h_s</code>, <code>k sqrt(h)</code>, back below it, and smooth where it changes its sign.</p>
<p>Source: E. Torricelli, De motu aquarum (1644).</p>
</html>"));
end RootLoss;
