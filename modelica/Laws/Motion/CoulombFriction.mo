within Laws.Motion;
model CoulombFriction "Dry friction"
  extends Laws.Interfaces.MotionLaw;
  parameter Real F_c(min = 0, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Dry friction";
protected
  final parameter Real v_smooth = 2e-5 * v_n "Speed over which friction changes its sign";
equation
  f = F_c * tanh(v / v_smooth);
  annotation (Documentation(info = "<html>
<p><code>F_c sign(v)</code>, the step rounded over <code>v_smooth</code>.</p>
<p>Source: C. A. Coulomb, Th&eacute;orie des machines simples (1785); H. Olsson et al., Friction models and friction compensation, European Journal of
Control 4 (1998), 176-195.</p>
</html>"));
end CoulombFriction;
