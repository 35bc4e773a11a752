within Aero.Aerodynamics;
model FreeThruster "Thruster on a body that is free to turn about the rotor's axis"
  extends Thruster;
  parameter Real hand = 1 "1 where a positive speed turns to positive angles of the axis, -1 where to negative ones";
  Interfaces.Flange housing "Body about the rotor's axis" annotation (Placement(transformation(extent = {{-10, -110}, {10, -90}})));
  Real H(unit = "N.m.s") "Angular momentum of the rotor about the axis";
equation
  H = hand * motor.J_t * motor.rotor.w;
  housing.tau = hand * (motor.J_t * der(motor.rotor.w) + propeller.flange.tau);
  annotation (
    Icon(graphics = {Ellipse(extent = {{-80, 40}, {80, -40}}, lineColor = {0, 0, 0}), Line(points = {{0, -90}, {0, 60}}, color = {0, 0, 0}),
      Text(extent = {{-100, 100}, {100, 70}}, textString = "%name")}),
    Documentation(info = "<html><p>What turns the rotor pushes back on the body: the torque that speeds the rotor up and the one that the air takes. The speed is that
of the rotor in its housing. The body's own acceleration is left out of the rotor's balance: it is a thousandth of the rotor's.</p></html>"));
end FreeThruster;
