package Rig "Two inertias on an elastic shaft"
  connector Flange "End of a shaft, with speed and torque"
    Real w(unit = "rad/s") "Angular velocity";
    flow Real tau(unit = "N.m") "Torque into the component";
  end Flange;

  model Inertia "Rotating mass"
    parameter Real J(unit = "kg.m2", min = 0) = 1 "Moment of inertia";
    Flange flange_a;
    Flange flange_b;
    Real w(unit = "rad/s", start = 0, fixed = true) "Angular velocity";
  equation
    flange_a.w = w;
    flange_b.w = w;
    J * der(w) = flange_a.tau + flange_b.tau;
  end Inertia;

  model Shaft "Torsional spring and damper"
    parameter Real c(unit = "N.m/rad", min = 0) = 1 "Stiffness";
    parameter Real d(unit = "N.m.s/rad", min = 0) = 1 "Damping";
    Flange flange_a;
    Flange flange_b;
    Real phi(unit = "rad", start = 0, fixed = true) "Twist";
  equation
    der(phi) = flange_a.w - flange_b.w;
    flange_a.tau = c * phi + d * (flange_a.w - flange_b.w);
    flange_a.tau + flange_b.tau = 0;
  end Shaft;

  model Bearing "Viscous friction against the housing"
    parameter Real d(unit = "N.m.s/rad", min = 0) = 1 "Damping";
    Flange flange;
  equation
    flange.tau = d * flange.w;
  end Bearing;

  model Torque "Torque given by a signal"
    input Real tau(unit = "N.m") "Torque on what is connected";
    Flange flange;
  equation
    flange.tau = -tau;
  end Torque;

  model Drivetrain "A motor turns a load over a shaft"
    input Real tau(unit = "N.m") "Torque of the motor";
    output Real w_motor(unit = "rad/s") "Speed at the motor, as measured";
    output Real w_load(unit = "rad/s") "Speed at the load, as measured";
    Torque torque(tau = tau);
    Inertia motor(J = 0.02);
    Shaft shaft(c = 4, d = 0.02);
    Inertia load(J = 0.05);
    Bearing bearing(d = 0.04);
  equation
    connect(torque.flange, motor.flange_a);
    connect(motor.flange_b, shaft.flange_a);
    connect(shaft.flange_b, load.flange_a);
    connect(load.flange_b, bearing.flange);
    w_motor = motor.w;
    w_load = load.w;
  end Drivetrain;
end Rig;
