model Rig "A servo motor turns a second one"
  parameter Real J(unit = "kg.m2", min = 0) = 0.000173 "Moment of inertia of both";
  parameter Real B(unit = "N.m.s/rad", min = 0) = 0.000129 "Viscous friction";
  parameter Real F_c(unit = "N.m", min = 0) = 0.0207 "Dry friction, mean of both directions";
  parameter Real d(min = -1, max = 1) = 0.416 "Share by which it is more at positive speeds and less at negative ones";
  input Real tau(unit = "N.m") "Torque of the motor, as commanded";
  output Real w(unit = "rad/s", start = 0, fixed = true) "Speed, as measured";
equation
  J * der(w) = tau - B * w - F_c * tanh(w / 0.01) * (1 + d * tanh(w / 0.01));
end Rig;
