within Laws.Interfaces;
partial model ExchangeLaw "Flow from a storage into another of its kind"
  parameter Real q_n = 1 "Typical size of the flow";
  parameter Real h_n = 1 "Typical size of the level; of a temperature, above where it starts";
  parameter Real d_n = 1 "Typical size of the difference of the two levels";
  parameter Real t_n = 1 "Typical time of the port's signals";
  input Real h_1 "Level of the storage";
  input Real h_2 "Level of its neighbour";
  output Real q "Flow from the storage into its neighbour";
  annotation (Documentation(info = "<html>
<p>Extend it with one equation for <code>q</code>, which is zero where the first parameter has its default.</p>
</html>"));
end ExchangeLaw;
