within Laws.Interfaces;
partial model OutputLaw "What lies between a quantity and its reading"
  parameter Real u_n = 1 "Typical size of the quantity";
  parameter Real t_n = 1 "Typical time of the port's signals";
  input Real u(stateSelect = StateSelect.avoid) "Quantity in the model";
  output Real y "Quantity as read";
  annotation (Documentation(info = "<html>
<p>Extend it with one equation for <code>y</code>, which is <code>u</code> where the first parameter has its default. <code>der(u)</code> may be used.</p>
</html>"));
end OutputLaw;
