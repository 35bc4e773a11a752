within Laws.Motion;
model QuadraticDrag "Drag by the square of the speed"
  extends Laws.Interfaces.MotionLaw;
  parameter Real c(min = 0, max = 10 * f_n / v_n ^ 2, nominal = 0.1 * f_n / v_n ^ 2) = 0 "Drag";
equation
  f = c * v * abs(v);
  annotation (Documentation(info = "<html>
<p><code>c v |v|</code>: a blunt body in air or water.</p>
<p>Source: L. Prandtl, O. Tietjens, Applied Hydro- and Aeromechanics (McGraw-Hill, 1934), ch. 5.</p>
</html>"));
end QuadraticDrag;
