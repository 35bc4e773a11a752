within Aero.Effects;
model RotorViscousFriction "Viscous friction of the rotor"
  extends Interfaces.RotorEffect;
  parameter Real d_r(unit = "N.m.s/rad", min = 0, nominal = 1e-6) = 0 "Friction torque for each unit of speed";
equation
  flange.tau = d_r * flange.w;
  annotation (
    Documentation(info = "<html>
<p>A torque <code>d_r w</code> beside the propeller's drag.</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-45, -25}, {45, 25}}, color = {60, 60, 60})}));
end RotorViscousFriction;
