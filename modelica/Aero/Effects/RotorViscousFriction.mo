within Aero.Effects;
model RotorViscousFriction "Viscous friction of the rotor"
  extends Interfaces.RotorEffect;
  parameter Real d_r(unit = "N.m.s/rad", min = 0, max = 0.0002, nominal = 2e-06) = 0 "Viscous friction of a rotor";
equation
  flange.tau = d_r * flange.w;
  annotation (
    Documentation(info = "<html>
<p>A torque <code>d_r w</code> beside the propeller's drag.</p>
</html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {Line(points = {{-45, -25}, {45, 25}}, color = {60, 60, 60})}));
end RotorViscousFriction;
