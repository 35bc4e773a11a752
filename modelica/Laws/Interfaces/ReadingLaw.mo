within Laws.Interfaces;
partial model ReadingLaw "What lies between a quantity whose rate nothing gives, such as the output of an FMU, and its reading"
  parameter Real u_n = 1 "Typical size of the quantity";
  parameter Real t_n = 1 "Typical time of the port's signals";
  input Real u "Quantity in the model";
  output Real y "Quantity as read";
  annotation (Documentation(info = "<html>
<p>Extend it with one equation for <code>y</code>, which is <code>u</code> where the first parameter has its default. What needs <code>der(u)</code> elsewhere
has states of its own here, which start in steady state by an initial equation.</p>
</html>"));
end ReadingLaw;
