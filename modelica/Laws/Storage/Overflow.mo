within Laws.Storage;
model Overflow "Spilling above a level"
  extends Laws.Interfaces.OverflowLaw;
  parameter Real k_o(min = 0, max = 1000 * q_n / h_n, nominal = 10 * q_n / h_n) = 0 "Spilled flow for each unit of level above the edge";
  parameter Real h_o(min = 0.05 * h_n, max = 1.2 * h_n, nominal = 0.9 * h_n) = 0.9 * h_n "Level of the edge";
protected
  final parameter Real h_smooth = 2e-3 * h_n "Width of the rounding at the edge";
equation
  q = k_o * 0.5 * (h - h_o + sqrt((h - h_o) ^ 2 + h_smooth ^ 2));
  annotation (__aero_bayes(not_for = "K A", nonnegative = "h"),
    Documentation(info = "<html>
<p>What rises above the edge at <code>h_o</code> leaves the storage, the faster the higher it stands; with a large <code>k_o</code> all the surplus of the inflow
spills. The <code>share</code> of it reaches the neighbouring storage.</p>
<p>Source: M. Schoukens, P. Mattsson, T. Wigren, J.-P. No&euml;l, Cascaded tanks benchmark combining soft and hard nonlinearities (2016).</p>
</html>"));
end Overflow;
