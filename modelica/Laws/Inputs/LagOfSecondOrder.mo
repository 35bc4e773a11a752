within Laws.Inputs;
model LagOfSecondOrder "An actuator that follows its input late and may overshoot"
  extends Laws.Interfaces.InputLaw;
  parameter Real T_l(min = 0, max = 10 * t_n, nominal = 0.1 * t_n) = 0 "Inverse of the angular frequency";
  parameter Real d_l(min = 0.05, max = 5, nominal = 0.7) = 0.7 "Damping ratio";
  parameter Real start_z(min = -10 * u_n, max = 10 * u_n, nominal = u_n) = 0 "Where it is at the start, beyond the input there";
  Real z(nominal = u_n) "Quantity after the lag";
  Real w(start = 0, fixed = true, nominal = u_n) "Its rate of change in units of its time";
protected
  final parameter Real T_min = 1e-3 * t_n "Lag below which it is taken to first order";
  parameter Real T = if T_l > 0 then (T_l ^ 4 + T_min ^ 4) ^ 0.25 else 1e6 * t_n "Time in use; without one nothing moves";
initial equation
  z = u + start_z;
equation
  T * der(z) = w;
  T * der(w) = u - z - 2 * d_l * w;
  y = u - T_l / T * (u - z);
  annotation (__aero_bayes(refines = "lag"), Documentation(info = "<html>
<p><code>T_l^2 d2y/dt2 + 2 d_l T_l dy/dt + y = u</code>, from its steady state. A lag shorter than <code>T_min</code> is taken to first order in <code>T_l</code>;
at zero nothing is left of it.</p>
<p>Source: L. Ljung, System Identification (Prentice Hall, 1999), ch. 4.</p>
</html>"));
end LagOfSecondOrder;
