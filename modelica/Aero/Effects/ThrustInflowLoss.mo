within Aero.Effects;
model ThrustInflowLoss "Thrust that falls as the propeller moves along its axis"
  extends Laws.Interfaces.InputLaw;
  parameter Real k_v(unit = "N.s2/(m.rad)", min = 0, max = 0.005, nominal = 0.0001) = 0 "Loss of thrust by speed and velocity";
  input Real w(unit = "rad/s") "Speed of the propeller";
  input Real v(unit = "m/s") "Velocity of the propeller along its axis";
equation
  y = u - k_v * abs(w) * v;
  annotation (
    Documentation(info = "<html>
<p>A propeller that moves in the direction of its thrust meets the air at a smaller angle of attack; to first order the loss is
<code>k_v |w| v</code>. On the pivoted body it acts as damping that grows with the rotor's speed.</p>
<p>Source: J. G. Leishman, Principles of Helicopter Aerodynamics (Cambridge, 2006), ch. 2: momentum theory.</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-45, -15}, {45, 25}}, color = {60, 60, 60})}));
end ThrustInflowLoss;
