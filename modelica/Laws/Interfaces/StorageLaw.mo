within Laws.Interfaces;
partial model StorageLaw "Flow that leaves a storage"
  parameter Real q_n = 1 "Typical size of the flow";
  parameter Real h_n = 1 "Typical size of the level; of a temperature, above where it starts";
  parameter Real h_0 = 0 "Level of the surroundings, the mean of one that changes";
  parameter Real h_z = 0 "Absolute zero of the level";
  parameter Real t_n = 1 "Typical time of the port's signals";
  input Real h "Level, potential or temperature";
  input Real h_s "Level of the surroundings";
  output Real q "Flow that leaves";
  annotation (Documentation(info = "<html>
<p>Extend it with one equation for <code>q</code>, which is zero where the first parameter has its default.
<code>h_s</code> is <code>h_0</code> where the surroundings are not recorded.</p>
</html>"));
end StorageLaw;
