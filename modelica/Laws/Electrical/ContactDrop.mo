within Laws.Electrical;
model ContactDrop "A voltage drop that hardly depends on the current"
  extends Laws.Interfaces.SeriesLaw;
  parameter Real V_c(min = 0, max = v_n, nominal = 0.1 * v_n) = 0 "Voltage drop";
protected
  final parameter Real i_smooth = 2e-5 * i_n "Current over which the drop changes its sign";
equation
  v = V_c * tanh(i / i_smooth);
  annotation (Documentation(info = "<html>
<p>Carbon brushes, diodes, arcs: <code>V_c sign(i)</code>, the step rounded over <code>i_smooth</code>.</p>
<p>Source: R. Holm, Electric Contacts (Springer, 1967), part IV.</p>
</html>"));
end ContactDrop;
