model Rlc "A resonant circuit"
  parameter Real R(unit = "Ohm") = 2;
  parameter Real L(unit = "H") = 0.05;
  parameter Real C(unit = "F") = 0.01;
  input Real u(unit = "V");
  output Real u_C(unit = "V") = v_C;
  Real i(unit = "A", start = 0, fixed = true);
  Real v_C(unit = "V", start = 0, fixed = true);
equation
  u = R * i + L * der(i) + v_C "Kirchhoff";
  C * der(v_C) = i;
end Rlc;
