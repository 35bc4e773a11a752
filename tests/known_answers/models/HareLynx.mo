model HareLynx "Lotka-Volterra populations on logarithmic axes"
  parameter Real alpha(unit = "1/s", min = 1e-3, max = 5) = 0.55 "Growth of hares, a year";
  parameter Real beta(unit = "1/s", min = 1e-5, max = 0.5) = 0.028 "Loss of hares per lynx";
  parameter Real gamma(unit = "1/s", min = 1e-3, max = 5) = 0.8 "Loss of lynxes";
  parameter Real delta(unit = "1/s", min = 1e-5, max = 0.5) = 0.024 "Growth of lynxes per hare";
  Real hare(start = 3.5, fixed = true) "Logarithm of hares, thousands";
  Real lynx(start = 1.8, fixed = true) "Logarithm of lynxes, thousands";
  output Real log_hare = hare;
  output Real log_lynx = lynx;
equation
  der(hare) = alpha - beta * exp(lynx);
  der(lynx) = delta * exp(hare) - gamma;
end HareLynx;
