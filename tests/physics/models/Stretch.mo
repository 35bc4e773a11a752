package Stretch "Two bodies on springs, by connectors that carry a position"
  connector Flange
    Real s(unit = "m");
    flow Real f(unit = "N");
  end Flange;
  model Mass
    parameter Real m(unit = "kg") = 1;
    parameter Real L(unit = "m") = 0 "Length";
    Real s(unit = "m", start = 0, fixed = true);
    Real v(unit = "m/s", start = 0, fixed = true);
    Real a(unit = "m/s2");
    Flange left, right;
  equation
    left.s = s - L / 2;
    right.s = s + L / 2;
    v = der(s);
    a = der(v);
    m * a = left.f + right.f;
  end Mass;
  model SpringDamper
    parameter Real c(unit = "N/m") = 20;
    parameter Real d(unit = "N.s/m") = 0.5;
    Real s_rel(unit = "m");
    Real v_rel(unit = "m/s");
    Real f(unit = "N");
    Real f_d(unit = "N");
    Flange left, right;
  equation
    s_rel = right.s - left.s;
    v_rel = der(s_rel);
    f = c * s_rel + f_d;
    f_d = d * v_rel;
    left.f = -f;
    right.f = f;
  end SpringDamper;
  model Wall
    parameter Real s0(unit = "m") = 0;
    Flange flange;
  equation
    flange.s = s0;
  end Wall;
  model Accelerometer
    Flange flange;
    Real v(unit = "m/s");
    output Real a(unit = "m/s2");
  equation
    flange.f = 0;
    v = der(flange.s);
    a = der(v);
  end Accelerometer;
  model Push
    input Real u(unit = "N");
    Flange flange;
  equation
    flange.f = -u;
  end Push;
  model Absorber
    input Real u(unit = "N");
    output Real a(unit = "m/s2");
    Mass first(m = 2, L = 0.1), second;
    SpringDamper mount, link(c = 5, d = 0.2), beside(c = 1, d = 0.1);
    Wall wall;
    Accelerometer sensor;
    Push push;
  equation
    push.u = u;
    a = sensor.a;
    connect(wall.flange, mount.left);
    connect(mount.right, first.left);
    connect(first.right, link.left);
    connect(link.right, second.left);
    connect(first.right, beside.left);
    connect(beside.right, second.left);
    connect(push.flange, first.left);
    connect(sensor.flange, second.right);
  end Absorber;
end Stretch;
