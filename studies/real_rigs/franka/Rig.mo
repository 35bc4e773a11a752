model Rig "The friction of a joint of a robot arm"
  parameter Real B(unit = "N.m.s/rad", min = 0) = 0.5 "Viscous friction";
  parameter Real tau_0(unit = "N.m") = 0 "Torque at rest";
  input Real dq(unit = "rad/s") "Speed of the joint, as measured";
  output Real tau(unit = "N.m") "Torque that friction takes, as measured";
equation
  tau = B * dq + tau_0;
end Rig;
