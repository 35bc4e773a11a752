within Laws.Motion;
model StribeckFriction "Dry friction that falls once it slides"
  extends Laws.Interfaces.MotionLaw;
  parameter Real F_c(min = 0, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Dry friction while sliding";
  parameter Real r(min = 0, max = 5, nominal = 0.5) = 0.5 "Share by which friction is larger at rest";
  parameter Real v_s(min = 1e-3 * v_n, max = v_n, nominal = 0.05 * v_n) = 0.05 * v_n "Speed at which the excess has fallen to 1/e";
protected
  final parameter Real v_smooth = 2e-5 * v_n "Speed over which friction changes its sign";
equation
  f = F_c * (1 + r * exp(-(v / v_s) ^ 2)) * tanh(v / v_smooth);
  annotation (__aero_bayes(refines = "coulomb_friction"),
    Documentation(info = "<html>
<p>Break-away needs <code>F_c (1 + r)</code>, sliding <code>F_c</code>.</p>
<p>Source: R. Stribeck, Die wesentlichen Eigenschaften der Gleit- und Rollenlager, Zeitschrift des VDI 46 (1902); L. C. Bo, D. Pavelescu, The
friction-speed relation, Wear 82 (1982), 277-289.</p>
</html>"));
end StribeckFriction;
