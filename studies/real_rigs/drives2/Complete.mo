model Rig "Two motors drive a belt; a pulley on it is held by a spring"
  parameter Real T(unit = "s", min = 0) = 0.162 "Time constant of the motors";
  parameter Real K(min = 0) = 3.03 "Speed of the motors by the voltage";
  parameter Real w0(unit = "rad/s", min = 0) = 20.1 "Natural frequency of the pulley on the belt";
  parameter Real zeta(min = 0) = 0.16 "Damping ratio of the pulley on the belt";
  parameter Real s(min = -1, max = 2) = 0.3 "Share of the voltage that acts by its square";
  input Real u "Voltage of both motors";
  output Real y "Speed of the pulley, as measured by a pulse counter";
  Real m(start = 0, fixed = true) "Speed of the motors";
  Real w(start = 0, fixed = true) "Speed of the pulley";
  Real a(start = 0, fixed = true) "Acceleration of the pulley";
equation
  T * der(m) = K * ((1 - s) * u + s * u * abs(u) / 1.5) - m;
  der(w) = a;
  der(a) = w0 ^ 2 * (m - w) - 2 * zeta * w0 * a;
  y = abs(w);
end Rig;
