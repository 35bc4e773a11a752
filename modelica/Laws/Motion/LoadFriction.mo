within Laws.Motion;
model LoadFriction "Dry friction that grows with the load"
  extends Laws.Interfaces.MotionLaw;
  parameter Real L(min = 0, max = 10, nominal = 0.1) = 0 "Friction per load";
  parameter Real f_0(min = 0, max = 10 * f_n, nominal = 0.5 * f_n) = 0 "Load that is always there, such as a preload";
protected
  final parameter Real v_smooth = 2e-5 * v_n "Speed over which friction changes its sign";
equation
  f = L * (f_0 + abs(load)) * tanh(v / v_smooth);
  annotation (__aero_bayes(refines = "coulomb_friction"), Documentation(info = "<html>
<p><code>(F_c + L |load|) sign(v)</code> with <code>F_c = L f_0</code>, the step rounded over <code>v_smooth</code>. In a gear, the teeth are pressed together by the
torque that they pass on: with <code>f_0 = 0</code> this is a gear whose efficiency is <code>1 - L</code> where it is driven, if damping is small beside the torque. <code>load</code> is the rest of the balance: every term but the acceleration and other laws.</p>
<p>Source: P. Hamon, M. Gautier, P. Garrec, Dynamic identification of robots with a dry friction model depending on load and velocity, IEEE/RSJ IROS
(2010), 6187-6193.</p>
</html>"));
end LoadFriction;
