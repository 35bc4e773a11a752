within ;
package Bodies "Heated bodies that touch"
  connector Port "Heat"
    Real T(unit = "K");
    flow Real Q(unit = "W");
  end Port;

  model Body
    Port port;
    parameter Real C(unit = "J/K") = 20;
    Real T(unit = "K", start = 295, fixed = true);
  equation
    T = port.T;
    C * der(T) = port.Q;
  end Body;

  model Wall
    Port a;
    Port b;
    parameter Real G(unit = "W/K") = 0.2;
  equation
    a.Q = G * (a.T - b.T);
    a.Q + b.Q = 0;
  end Wall;

  model Heater
    Port port;
    input Real P(unit = "W");
  equation
    port.Q = -P;
  end Heater;

  model Room
    Port port;
    parameter Real T(unit = "K") = 295;
  equation
    port.T = T;
  end Room;

  model Pair "A heated body and one beside it"
    input Real P(unit = "W");
    output Real T_1(unit = "K") = one.T;
    output Real T_2(unit = "K") = two.T;
    Body one;
    Body two(C = 30);
    Heater heater(P = P);
    Wall between;
    Wall outside(G = 0.1);
    Room room;
  equation
    connect(heater.port, one.port);
    connect(one.port, between.a);
    connect(between.b, two.port);
    connect(two.port, outside.a);
    connect(outside.b, room.port);
  end Pair;
end Bodies;
