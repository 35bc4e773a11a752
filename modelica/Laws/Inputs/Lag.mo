within Laws.Inputs;
model Lag "An actuator that follows its input late"
  extends Laws.Interfaces.InputLaw;
  parameter Real T_l(min = 0, max = 10 * t_n, nominal = 0.1 * t_n) = 0 "Time constant";
  parameter Real start_z(min = -10 * u_n, max = 10 * u_n, nominal = u_n) = 0 "Where it is at the start, beyond the input there";
  Real z(nominal = u_n) "Input after the lag";
protected
  final parameter Real T_min = 1e-3 * t_n "Lag below which it is taken to first order";
  parameter Real T = if T_l > 0 then (T_l ^ 4 + T_min ^ 4) ^ 0.25 else 1e6 * t_n "Time constant in use; without one nothing moves";
initial equation
  z = u + start_z;
equation
  T * der(z) = u - z;
  y = u - T_l / T * (u - z);
  annotation (Documentation(info = "<html>
<p><code>T_l dy/dt = u - y</code>. A lag shorter than <code>T_min</code> is taken to first order in <code>T_l</code>, so that the equations stay regular down to
zero, where nothing is left of it. Before the start the input was what it is there, or <code>start_z</code> more: a recording may begin in motion.</p>
<p>Source: L. Ljung, System Identification (Prentice Hall, 1999), ch. 4.</p>
</html>"));
end Lag;
