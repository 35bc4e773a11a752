model Cart "A cart on a rail, pulled by a force and held by a spring"
  parameter Real M(unit = "kg", min = 0.1, max = 100) = 2 "Mass";
  parameter Real F_v(unit = "N.s/m", min = 0, max = 100) = 1.5 "Viscous friction"; // of the bearings
  parameter Real K(unit = "N/m", min = 0, max = 1000) = 8 "Stiffness";
  input Real F(unit = "N") "Pull";
  output Real q(unit = "m") = x "Position";
  Real x(unit = "m", start = 0.1, fixed = true) "Position";
  Real v(unit = "m/s", start = 0, fixed = true) "Velocity";
equation
  der(x) = v;
  // the balance of forces; "equation" is only a word here
  M * der(v) = F - F_v * v - K * x "Newton's second law" annotation (Documentation(info = "a balance; of forces"));
end Cart;
