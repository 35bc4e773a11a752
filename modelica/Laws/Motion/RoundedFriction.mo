within Laws.Motion;
model RoundedFriction "Dry friction that changes its sign over a speed"
  extends Laws.Interfaces.MotionLaw;
  parameter Real F_c(min = 0, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Dry friction while sliding";
  parameter Real v_c(min = 1e-5 * v_n, max = 0.2 * v_n, nominal = 3e-3 * v_n) = 3e-3 * v_n "Speed over which friction changes its sign";
equation
  f = F_c * tanh(v / v_c);
  annotation (__aero_bayes(refines = "coulomb_friction", both_signs = "v"),
    Documentation(info = "<html>
<p><code>F_c tanh(v / v_c)</code>: a lubricated contact creeps under less than <code>F_c</code>, at a speed of the order of <code>v_c</code>.</p>
<p>Source: S. Andersson, A. S&ouml;derberg, S. Bj&ouml;rklund, Friction models for sliding dry, boundary and mixed lubricated contacts, Tribology
International 40 (2007), 580-587.</p>
</html>"));
end RoundedFriction;
