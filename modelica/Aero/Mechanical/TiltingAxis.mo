within Aero.Mechanical;
model TiltingAxis "Axis of a rotor that is upright where the body is level and tilts as the body pitches"
  input Real theta(unit = "rad") "Pitch angle of the body";
  input Real H(unit = "N.m.s") "Angular momentum of the rotor about its axis";
  Interfaces.Flange housing "Body about the rotor's axis" annotation (Placement(transformation(extent = {{-110, -10}, {-90, 10}})));
  Interfaces.Flange pitch "Body about the pitch axis" annotation (Placement(transformation(extent = {{90, -60}, {110, -40}})));
  Interfaces.Flange yaw "Body about the yaw axis" annotation (Placement(transformation(extent = {{90, 40}, {110, 60}})));
equation
  housing.w = yaw.w * cos(theta);
  yaw.tau + housing.tau * cos(theta) + H * sin(theta) * pitch.w = 0;
  pitch.tau = H * sin(theta) * yaw.w;
  annotation (
    Documentation(info = "<html><p>What the rotor takes from its axis, the body gets about the yaw axis, by the cosine of the tilt. Tilted, the rotor is a gyroscope between
pitch and yaw: its part along the vertical is <code>H cos(theta)</code>, so that <code>H sin(theta)</code> times the rate of the one axis is a
torque about the other. The gyroscopic torques do no work; power is kept.</p></html>"),
    Icon(coordinateSystem(extent = {{-100, -100}, {100, 100}}), graphics = {
      Line(points = {{0, -90}, {0, 90}}, color = {160, 160, 160}, pattern = LinePattern.Dash),
      Line(points = {{-30, -80}, {30, 80}}, color = {60, 60, 60}, thickness = 2),
      Ellipse(extent = {{-50, 25}, {50, -25}}, lineColor = {60, 60, 60}, fillColor = {200, 210, 225}, fillPattern = FillPattern.Solid),
      Text(extent = {{-150, 140}, {150, 100}}, textString = "%name")}));
end TiltingAxis;
