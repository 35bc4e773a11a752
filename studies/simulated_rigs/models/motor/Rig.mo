model Rig "DC motor"
  parameter Real R(unit = "Ohm", min = 0) = 2 "Resistance of the winding";
  parameter Real L(unit = "H", min = 0) = 0.02 "Inductance of the winding";
  parameter Real k_m(unit = "N.m/A", min = 0) = 0.08 "Torque constant";
  parameter Real J(unit = "kg.m2", min = 0) = 2e-4 "Inertia of rotor and load";
  parameter Real d(unit = "N.m.s/rad", min = 0) = 2e-4 "Viscous friction of the bearings";
  input Real V(unit = "V") "Voltage of the amplifier";
  output Real current(unit = "A") "Current, as measured";
  output Real speed(unit = "rad/s") "Speed, as measured";
  Real i(unit = "A", start = 0, fixed = true) "Current";
  Real w(unit = "rad/s", start = 0, fixed = true) "Speed";
equation
  // The winding
  L * der(i) = V - R * i - k_m * w;
  // The rotor
  J * der(w) = k_m * i - d * w;
  current = i;
  speed = w;
end Rig;
