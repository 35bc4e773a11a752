within Laws.Storage;
model SquareLoss "Loss by the square of the level"
  extends Laws.Interfaces.StorageLaw;
  parameter Real c(min = 0, max = 10 * q_n / h_n ^ 2, nominal = 0.1 * q_n / h_n ^ 2) = 0 "Loss at a level of one above the surroundings";
equation
  q = c * (h - h_s) * abs(h - h_s);
  annotation (__aero_bayes(not_for = "degC Cel"),
    Documentation(info = "<html>
<p><code>c h |h|</code>, with the level counted from that of the surroundings: evaporation from a widening surface, natural convection taken to its next power, turbulent loss over a speed.</p>
<p>Source: F. P. Incropera et al., Fundamentals of Heat and Mass Transfer (Wiley, 2007), ch. 9.</p>
</html>"));
end SquareLoss;
