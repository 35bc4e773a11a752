package Rig "A cart on a spring"
  connector Flange "End of a translational component, with velocity and force"
    Real v(unit = "m/s") "Velocity";
    flow Real f(unit = "N") "Force into the component";
  end Flange;

  model Mass "Sliding mass"
    parameter Real m(unit = "kg", min = 0) = 1 "Mass";
    Flange flange;
    Real v(unit = "m/s", start = 0, fixed = true) "Velocity";
  equation
    v = flange.v;
    m * der(v) = flange.f;
  end Mass;

  model Spring "Linear spring between two flanges"
    parameter Real k(unit = "N/m", min = 0) = 1 "Stiffness";
    Flange flange_a;
    Flange flange_b;
    Real s(unit = "m", start = 0, fixed = true) "Stretch";
  equation
    der(s) = flange_b.v - flange_a.v;
    flange_b.f = k * s;
    flange_a.f + flange_b.f = 0;
  end Spring;

  model Damper "Linear damper between two flanges"
    parameter Real d(unit = "N.s/m", min = 0) = 1 "Damping";
    Flange flange_a;
    Flange flange_b;
  equation
    flange_b.f = d * (flange_b.v - flange_a.v);
    flange_a.f + flange_b.f = 0;
  end Damper;

  model Wall "Fixed point"
    Flange flange;
  equation
    flange.v = 0;
  end Wall;

  model Drive "Force given by a signal"
    input Real f(unit = "N") "Force on what is connected";
    Flange flange;
  equation
    flange.f = -f;
  end Drive;

  model Cart "A driven cart, tied to a wall by a spring and a damper"
    input Real F(unit = "N") "Force of the actuator";
    output Real position(unit = "m") "Position of the cart, as measured";
    Mass mass(m = 1.5) "Weighed";
    Spring spring(k = 60);
    Damper damper(d = 2);
    Wall wall;
    Drive drive(f = F);
  equation
    connect(wall.flange, spring.flange_a);
    connect(wall.flange, damper.flange_a);
    connect(spring.flange_b, mass.flange);
    connect(damper.flange_b, mass.flange);
    connect(drive.flange, mass.flange);
    position = spring.s;
  end Cart;
end Rig;
