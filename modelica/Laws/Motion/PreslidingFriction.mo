within Laws.Motion;
model PreslidingFriction "Dry friction that yields before it slides and creeps under vibration"
  extends Laws.Interfaces.MotionLaw;
  parameter Real F_c(min = 0, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Dry friction while sliding";
  parameter Real x_p(min = 1e-5 * x_w, max = 0.5 * x_w, nominal = 1e-3 * x_w) = 1e-3 * x_w "Displacement by which the contact yields before it slides";
  parameter Real v_p(min = 1e-6 * v_n, max = 0.1 * v_n, nominal = 1e-4 * v_n) = 1e-4 * v_n "Speed of the vibration under which the contact creeps";
  Real z(start = 0, fixed = true, nominal = 1) "Share of the friction that is called up";
equation
  x_p * der(z) = v - sqrt(v ^ 2 + v_p ^ 2) * z;
  f = F_c * z;
  annotation (__aero_bayes(refines = "coulomb_friction", both_signs = "v"),
    Documentation(info = "<html>
<p>Dahl's model: the contact bends like a spring of <code>F_c / x_p</code> until it slides with <code>F_c</code>. Vibration of the speed <code>v_p</code> wears the
bend down, so that a body that is shaken creeps to rest.</p>
<p>Source: P. R. Dahl, A solid friction model, TOR-0158(3107-18)-1, The Aerospace Corporation (1968).</p>
</html>"));
end PreslidingFriction;
