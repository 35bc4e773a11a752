within ;
package Shaft "Rotating and electrical parts with connectors"
  connector Pin "Electrical pin"
    Real v(unit = "V");
    flow Real i(unit = "A");
  end Pin;

  connector Flange "Shaft end with its angle"
    Real phi(unit = "rad");
    flow Real tau(unit = "N.m");
  end Flange;

  partial model TwoPin
    Pin p;
    Pin n;
    Real v(unit = "V");
    Real i(unit = "A");
  equation
    v = p.v - n.v;
    i = p.i;
    p.i + n.i = 0;
  end TwoPin;

  model Source
    Pin p;
    Pin n;
    input Real u(unit = "V");
  equation
    p.i + n.i = 0;
    p.v - n.v = u;
  end Source;

  model Resistor
    extends TwoPin;
    parameter Real R(unit = "Ohm") = 1;
  equation
    v = R * i;
  end Resistor;

  model Inductor
    extends TwoPin(i(start = 0, fixed = true));
    parameter Real L(unit = "H") = 1e-2;
  equation
    L * der(i) = v;
  end Inductor;

  model Ground
    Pin p;
  equation
    p.v = 0;
  end Ground;

  model EMF
    extends TwoPin;
    Flange flange;
    parameter Real k(unit = "N.m/A") = 0.1;
    Real w(unit = "rad/s");
  equation
    w = der(flange.phi);
    v = k * w;
    flange.tau = -k * i;
  end EMF;

  model Inertia
    Flange a;
    Flange b;
    parameter Real J(unit = "kg.m2") = 1e-3;
    Real phi(unit = "rad", start = 0, fixed = true);
    Real w(unit = "rad/s", start = 0, fixed = true);
  equation
    phi = a.phi;
    phi = b.phi;
    w = der(phi);
    J * der(w) = a.tau + b.tau;
  end Inertia;

  model Spring "A shaft that twists"
    Flange a;
    Flange b;
    parameter Real c(unit = "N.m/rad") = 0.5;
    parameter Real d(unit = "N.m.s/rad") = 1e-3;
  equation
    a.tau = c * (a.phi - b.phi) + d * (der(a.phi) - der(b.phi));
    a.tau + b.tau = 0;
  end Spring;

  model Motor "DC motor that turns a load through a shaft"
    parameter Real R(unit = "Ohm", min = 0.1, max = 10) = 1;
    parameter Real J(unit = "kg.m2", min = 1e-5, max = 1e-1) = 1e-3 "Inertia of the load";
    input Real V(unit = "V") "Voltage";
    output Real speed(unit = "rad/s") = load.w;
    output Real current(unit = "A") = inductor.i;
    Source source(u = V) annotation (Placement(transformation(extent = {{-90, -10}, {-70, 10}})));
    Resistor resistor(R = R);
    Inductor inductor;
    EMF emf;
    Ground ground;
    Inertia rotor(J = 5e-4);
    Spring shaft;
    Inertia load(J = J);
  equation
    connect(source.p, resistor.p) annotation (Line(points = {{-80, 10}, {-60, 10}}));
    connect(resistor.n, inductor.p);
    connect(inductor.n, emf.p);
    connect(emf.n, source.n);
    connect(source.n, ground.p);
    connect(emf.flange, rotor.a);
    connect(rotor.b, shaft.a);
    connect(shaft.b, load.a);
  end Motor;
end Shaft;
