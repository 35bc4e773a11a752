within Laws.Motion;
model LinearStiffness "A spring"
  extends Laws.Interfaces.MotionLaw;
  parameter Real k(min = -10 * f_n / x_n, max = 10 * f_n / x_n, nominal = 0.1 * f_n / x_n) = 0 "Stiffness";
equation
  f = k * x;
  annotation (Documentation(info = "<html>
<p>A spring, a hose or cable that bends, the weight of a pendulum for small angles (negative above the pivot).</p>
<p>Source: R. Hooke, De Potentia Restitutiva (1678).</p>
</html>"));
end LinearStiffness;
