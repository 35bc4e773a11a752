within Aero.Effects;
model PivotPreslidingFriction "Dry friction at the pivot that yields elastically before it slides"
  extends Interfaces.BodyEffect;
  parameter Real tau_p(unit = "N.m", min = 0, max = 0.05, nominal = 0.001) = 0 "Dry friction torque at the pivot once it slides";
  parameter Real theta_p(unit = "rad", min = 0.0001, max = 0.3, nominal = 0.3) = 0.3 "Angle by which the pivot yields before it slides";
  parameter Real w_p(unit = "rad/s", min = 1e-05, max = 0.05, nominal = 0.05) = 0.05 "Rate of the vibration under which the pivot creeps";
  Real z(start = 0, fixed = true, nominal = 1) "Share of the friction torque that is called up";
equation
  theta_p * der(z) = flange.w - sqrt(flange.w ^ 2 + w_p ^ 2) * z;
  flange.tau = tau_p * z;
  annotation (__aero_bayes(refines = "pivot_coulomb_friction"),
    Documentation(info = "<html>
<p>Dahl's model: the contact bends like a spring of <code>tau_p / theta_p</code> until it slides with <code>tau_p</code>. Vibration of the rate
<code>w_p</code> wears the bend down, so that a body that is shaken creeps to rest.</p>
<p>Source: P. R. Dahl, A solid friction model, TOR-0158(3107-18)-1, The Aerospace Corporation (1968).</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-45, -25}, {-30, -25}, {0, -10}, {15, 25}, {45, 25}}, color = {60, 60, 60})}));
end PivotPreslidingFriction;
