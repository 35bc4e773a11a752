within Aero;
package Effects "Physics that the base model lacks, one component for each effect"
  annotation (
    Documentation(info = "<html><p>Each effect extends the partial model of its port and is put in by redeclaring the port's model, for instance</p>
<pre>model OneDof_pivot_coulomb_friction
  extends Aero.Systems.OneDof(redeclare model BodyEffect = Aero.Effects.PivotCoulombFriction, bodyEffect(tau_c = tau_c));
  parameter Real tau_c(unit = \"N.m\") = 0;
end OneDof_pivot_coulomb_friction;</pre>
<p>Where its parameter is zero an effect changes nothing. Where the truth has a corner it is rounded, and the width of the rounding is a
parameter of the component.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Rectangle(extent = {{-100, 100}, {100, -100}}, lineColor = {95, 95, 95}, fillColor = {245, 245, 245}, fillPattern = FillPattern.Solid, radius = 15),
      Rectangle(extent = {{-60, 40}, {60, -40}}, lineColor = {60, 60, 60}, fillColor = {255, 248, 220}, fillPattern = FillPattern.Solid)}));
end Effects;
