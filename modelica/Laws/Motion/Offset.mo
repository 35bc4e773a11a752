within Laws.Motion;
model Offset "A constant force"
  extends Laws.Interfaces.MotionLaw;
  parameter Real F_0(min = -10 * f_n, max = 10 * f_n, nominal = 0.1 * f_n) = 0 "Force against the positive direction";
equation
  f = F_0;
  annotation (Documentation(info = "<html>
<p>Weight, a tilt, a cable that pulls, an unbalanced motor.</p>
<p>Source: A. Janot, M. Gautier, M. Brunot, Data set and reference models of EMPS, Workshop on Nonlinear System Identification Benchmarks (2019).</p>
</html>"));
end Offset;
