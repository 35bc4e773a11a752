within Laws.Readings;
model Lag "A reading that follows as a first-order lag"
  extends Laws.Interfaces.ReadingLaw;
  parameter Real T_l(min = 0, max = 10 * t_n, nominal = 0.1 * t_n) = 0 "Time constant";
  Real z(nominal = u_n) "Quantity after the lag";
protected
  final parameter Real T_min = 1e-3 * t_n "Lag below which it is taken to first order";
  parameter Real T = if T_l > 0 then (T_l ^ 4 + T_min ^ 4) ^ 0.25 else 1e6 * t_n "Time constant in use; without one nothing moves";
initial equation
  z = u;
equation
  T * der(z) = u - z;
  y = u - T_l / T * (u - z);
  annotation (Documentation(info = "<html>
<p><code>T_l dy/dt = u - y</code>, from its steady state: <code>Laws.Outputs.Lag</code> without the rate of <code>u</code>.</p>
<p>Source: L. Ljung, System Identification (Prentice Hall, 1999), ch. 4.</p>
</html>"));
end Lag;
