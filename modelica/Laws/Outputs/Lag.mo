within Laws.Outputs;
model Lag "A reading that follows as a first-order lag"
  extends Laws.Interfaces.OutputLaw;
  parameter Real T_l(min = 0, max = 10 * t_n, nominal = 0.1 * t_n) = 0 "Time constant";
  Real q(start = 0, fixed = true, nominal = u_n) "Rate of change of the reading in units of its time";
protected
  final parameter Real T_min = 1e-3 * t_n "Lag below which it is taken to first order";
  parameter Real T = if T_l > 0 then (T_l ^ 4 + T_min ^ 4) ^ 0.25 else 1e6 * t_n "Time constant in use; without one nothing moves";
equation
  T * der(q) = (if T_l > 0 then T else 0) * der(u) - q;
  y = u - T_l / T * q;
  annotation (Documentation(info = "<html>
<p>A filter in the instrument: <code>T_l dy/dt = u - y</code>, written by the rate so that it starts in its steady state whatever the quantity is. A lag
shorter than <code>T_min</code> is taken to first order in <code>T_l</code>; at zero nothing is left of it.</p>
<p>Source: L. Ljung, System Identification (Prentice Hall, 1999), ch. 4.</p>
</html>"));
end Lag;
