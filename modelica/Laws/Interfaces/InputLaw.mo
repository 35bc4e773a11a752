within Laws.Interfaces;
partial model InputLaw "What lies between an input and what it acts on"
  parameter Real u_n = 1 "Typical size of the input";
  parameter Real t_n = 1 "Typical time of the port's signals";
  parameter Real w_n = 1 "Rate at which the input moves, in its size a typical time: half of all its movement is faster";
  input Real u "Input as recorded";
  output Real y "Input as it acts";
  annotation (Documentation(info = "<html>
<p>Extend it with one equation for <code>y</code>, which is <code>u</code> where the first parameter has its default.</p>
</html>"));
end InputLaw;
