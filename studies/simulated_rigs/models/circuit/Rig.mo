package Rig "A coil, a capacitor and a load"
  connector Pin "Electrical pin"
    Real v(unit = "V") "Potential";
    flow Real i(unit = "A") "Current into the component";
  end Pin;

  model Source "Ideal amplifier"
    input Real u(unit = "V") "Voltage between the pins";
    Pin p;
    Pin n;
  equation
    p.v - n.v = u;
    p.i + n.i = 0;
  end Source;

  model Coil "Inductor"
    parameter Real L(unit = "H", min = 0) = 1 "Inductance";
    Pin p;
    Pin n;
    Real i(unit = "A", start = 0, fixed = true) "Current from p to n";
  equation
    L * der(i) = p.v - n.v;
    p.i = i;
    p.i + n.i = 0;
  end Coil;

  model Capacitor "Capacitor"
    parameter Real C(unit = "F", min = 0) = 1 "Capacitance";
    Pin p;
    Pin n;
    Real v(unit = "V", start = 0, fixed = true) "Voltage from p to n";
  equation
    v = p.v - n.v;
    C * der(v) = p.i;
    p.i + n.i = 0;
  end Capacitor;

  model Resistor "Resistor"
    parameter Real R(unit = "Ohm", min = 0) = 1 "Resistance";
    Pin p;
    Pin n;
  equation
    p.v - n.v = R * p.i;
    p.i + n.i = 0;
  end Resistor;

  model Ground "Potential zero"
    Pin p;
  equation
    p.v = 0;
  end Ground;

  model Circuit "Low-pass filter under load"
    input Real u(unit = "V") "Voltage of the amplifier";
    output Real v_out(unit = "V") "Voltage at the load, as measured";
    output Real i_in(unit = "A") "Current of the coil, as measured";
    Source source(u = u);
    Coil coil(L = 0.1);
    Capacitor capacitor(C = 1e-3);
    Resistor load(R = 20);
    Ground ground;
  equation
    connect(source.p, coil.p);
    connect(coil.n, capacitor.p);
    connect(coil.n, load.p);
    connect(capacitor.n, ground.p);
    connect(load.n, ground.p);
    connect(source.n, ground.p);
    v_out = capacitor.v;
    i_in = coil.i;
  end Circuit;
end Rig;
