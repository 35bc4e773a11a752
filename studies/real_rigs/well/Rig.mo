model Rig "Rain and evaporation move the head of groundwater"
  parameter Real S(min = 0) = 0.1 "Storage coefficient";
  parameter Real f(min = 0) = 1 "Share of the evaporation that is drawn";
  parameter Real c(unit = "d", min = 0) = 500 "Resistance of the drainage";
  parameter Real d(unit = "m") = 18 "Level of the drainage";
  input Real P(unit = "mm/d") "Rain";
  input Real E(unit = "mm/d") "Evaporation";
  output Real h(unit = "m") "Head, as measured";
  Real x(unit = "m", start = 19, fixed = true) "Head";
equation
  86400 * S * der(x) = (P - f * E) / 1000 - (x - d) / c;
  h = x;
end Rig;
