within Laws.Interfaces;
partial model MotionLaw "Force or torque that opposes a motion"
  parameter Real f_n = 1 "Typical size of the force or torque";
  parameter Real v_n = 1 "Typical size of the speed";
  parameter Real x_n = 1 "Typical size of the displacement";
  parameter Real x_w = 1 "Half of the range of the displacement";
  parameter Real x_0 = 0 "Middle of the range of the displacement";
  parameter Real t_n = 1 "Typical time of the port's signals";
  input Real v "Speed";
  input Real x = 0 "Displacement; a law that uses it fits only where there is one";
  input Real load = 0 "Rest of the balance, which drives the motion; a law that uses it fits only where it is a formula";
  output Real f "Force or torque, positive where it opposes the positive direction";
  annotation (Documentation(info = "<html>
<p>Extend it with one equation for <code>f</code>, which is zero where the first parameter has its default.</p>
</html>"));
end MotionLaw;
