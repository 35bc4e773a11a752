within Laws.Motion;
model FrictionByDirection "Dry friction that differs by direction"
  extends Laws.Interfaces.MotionLaw;
  parameter Real F_c(min = 0, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Dry friction, mean of both directions";
  parameter Real a(min = -1, max = 1, nominal = 0.2) = 0 "Share by which friction is more at positive speeds and less at negative ones";
protected
  final parameter Real v_smooth = 2e-5 * v_n "Speed over which friction changes its sign";
equation
  f = F_c * (tanh(v / v_smooth) + a);
  annotation (__aero_bayes(refines = "coulomb_friction", both_signs = "v"),
    Documentation(info = "<html>
<p><code>F_c (1 + a)</code> brakes a positive speed, <code>F_c (1 - a)</code> a negative one; at rest friction takes any value between them.</p>
<p>Source: B. Armstrong-H&eacute;louvry, P. Dupont, C. Canudas de Wit, A survey of models, analysis tools and compensation methods for the control of
machines with friction, Automatica 30 (1994), 1083-1138.</p>
</html>"));
end FrictionByDirection;
