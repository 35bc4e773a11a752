within Laws.Inputs;
model SquareLaw "An actuator that acts by the square of its input"
  extends Laws.Interfaces.InputLaw;
  parameter Real a(min = -0.5, max = 1.5, nominal = 0.5) = 0 "Share of the square law";
equation
  y = u + a * (u * abs(u) / u_n - u);
  annotation (Documentation(info = "<html>
<p>Between <code>u</code> at zero and <code>u |u| / u_n</code> at one, which are equal at <code>u_n</code>: thrust and drag of propellers and fans, the force of a
magnet, the flow of a nozzle over its pressure the other way round.</p>
<p>Source: J. G. Leishman, Principles of Helicopter Aerodynamics (Cambridge, 2006), ch. 2.</p>
</html>"));
end SquareLaw;
