within Laws.Interfaces;
partial model OverflowLaw "Flow that leaves a storage, a share of it into its neighbour"
  parameter Real q_n = 1 "Typical size of the flow";
  parameter Real h_n = 1 "Typical size of the level";
  parameter Real t_n = 1 "Typical time of the port's signals";
  parameter Real share(min = 0, max = 2, nominal = 0.5) = 0 "Share of the flow that reaches the neighbour";
  input Real h "Level";
  output Real q "Flow that leaves";
  output Real q_2 "Flow that reaches the neighbour";
equation
  q_2 = share * q;
  annotation (Documentation(info = "<html>
<p>Extend it with one equation for <code>q</code>, which is zero where the first parameter has its default.</p>
</html>"));
end OverflowLaw;
