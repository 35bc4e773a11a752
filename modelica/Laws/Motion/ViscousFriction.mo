within Laws.Motion;
model ViscousFriction "Friction in proportion to the speed"
  extends Laws.Interfaces.MotionLaw;
  parameter Real d(min = 0, max = 10 * f_n / v_n, nominal = 0.1 * f_n / v_n) = 0 "Viscous friction";
equation
  f = d * v;
  annotation (Documentation(info = "<html>
<p>Bearings with a full film of lubricant, eddy currents, laminar flow.</p>
<p>Source: H. Olsson et al., Friction models and friction compensation, European Journal of Control 4 (1998), 176-195.</p>
</html>"));
end ViscousFriction;
