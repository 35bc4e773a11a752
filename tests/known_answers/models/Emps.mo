model Emps "Electromechanical positioning system: a carriage with friction under its position controller"
  parameter Real M(unit = "kg", min = 10, max = 1000) = 80 "Inertia at the load";
  parameter Real F_v(unit = "N.s/m", min = 1, max = 5000) = 150 "Viscous friction";
  parameter Real F_c(unit = "N", min = 0, max = 500) = 10 "Coulomb friction";
  parameter Real offset(unit = "N", min = -100, max = 100) = 0 "Offset of the force";
  parameter Real g_tau(unit = "N/V") = 35.15 "Force per control voltage";
  parameter Real K_p(unit = "1/s") = 160.18 "Position gain";
  parameter Real K_v(unit = "V.s/m") = 243.45 "Speed gain";
  parameter Real w_s(unit = "m/s") = 1e-6 "Speed within which Coulomb friction turns over";
  input Real q_ref(unit = "m") "Position asked for";
  output Real q(unit = "m") = x "Position of the carriage";
  output Real V(unit = "V") "Control voltage";
  Real x(unit = "m", start = 0, fixed = true) "Position of the carriage";
  Real w(unit = "m/s", start = 0, fixed = true) "Speed of the carriage";
equation
  der(x) = w;
  V = K_v * (K_p * (q_ref - x) - w);
  M * der(w) = g_tau * V - F_v * w - F_c * tanh(w / w_s) - offset;
end Emps;
