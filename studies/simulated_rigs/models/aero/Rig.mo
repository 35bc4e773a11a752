model Rig "Two propellers that pitch a body, driven against each other"
  parameter Real R_a(unit = "Ohm", min = 0) = 8.4 "Resistance of a winding";
  parameter Real L_a(unit = "H", min = 0) = 1.16e-3 "Inductance of a winding";
  parameter Real c_m(unit = "N.m/A", min = 0) = 0.042 "Torque constant";
  parameter Real J_r(unit = "kg.m2", min = 0) = 4.0e-6 "Inertia of a rotor";
  parameter Real J_s(unit = "kg.m2", min = 0) = 4.0e-6 "Inertia of a propeller";
  parameter Real k_d(unit = "N.m.s2/rad2", min = 0) = 2.4e-8 "Drag of a propeller";
  parameter Real k_t(unit = "N.s2/rad2", min = 0) = 2.9e-7 "Thrust of a propeller";
  parameter Real J_p(unit = "kg.m2", min = 0) = 0.0219 "Inertia of the body";
  parameter Real D_p(unit = "N.m.s/rad", min = 0) = 0.0071 "Damping of the pivot";
  parameter Real K_sp(unit = "N.m/rad", min = 0) = 0.0375 "Stiffness of the body about its rest";
  parameter Real D_t(unit = "m", min = 0) = 0.158 "Arm of a propeller";
  input Real V_m(unit = "V") "Voltage of the first motor; the second has its opposite";
  output Real i_m(unit = "A") "Current, as measured";
  output Real omega_m(unit = "rad/s") "Speed, as measured";
  output Real pitch(unit = "rad") "Pitch, as measured";
  Real i(unit = "A", start = 0, fixed = true) "Current";
  Real w(unit = "rad/s", start = 0, fixed = true) "Speed of the rotor";
  Real theta(unit = "rad", start = 0, fixed = true) "Pitch of the body";
  Real q(unit = "rad/s", start = 0, fixed = true) "Rate of the pitch";
equation
  // The winding
  L_a * der(i) = V_m - R_a * i - c_m * w;
  // The rotor
  (J_r + J_s) * der(w) = c_m * i - k_d * w * abs(w);
  // The body, which both propellers pitch alike
  der(theta) = q;
  J_p * der(q) = 2 * D_t * k_t * w * abs(w) - D_p * q - K_sp * theta;
  i_m = i;
  omega_m = w;
  pitch = theta;
end Rig;
