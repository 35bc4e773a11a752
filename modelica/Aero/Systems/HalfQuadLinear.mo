within Aero.Systems;
model HalfQuadLinear "HalfQuad with thrust and drag in proportion to the speed"
  extends HalfQuad(
    redeclare model ThrustLaw = Aerodynamics.LinearThrust,
    redeclare model DragLaw = Aerodynamics.LinearDrag,
    k_d(unit = "N.m.s/rad", max = 1e-2, nominal = 1e-5) = 1e-5,
    k_t(unit = "N.s/rad", max = 1, nominal = 4.5e-4) = 4.5e-4);
  annotation (
    experiment(StartTime = 0, StopTime = 30, Tolerance = 1e-6),
    Documentation(info = "<html><p>The laws that the units and sizes of the paper's Table 1 ask for.</p></html>"));
end HalfQuadLinear;
