package Rig "A heater in a plate"
  connector HeatPort "Temperature and heat flow"
    Real T(unit = "K") "Temperature";
    flow Real Q(unit = "W") "Heat flow into the component";
  end HeatPort;

  model Body "Body of one temperature"
    parameter Real C(unit = "J/K", min = 0) = 1 "Heat capacity";
    HeatPort port;
    Real T(unit = "K", start = 293.15, fixed = true) "Temperature";
  equation
    T = port.T;
    C * der(T) = port.Q;
  end Body;

  model Conductor "Heat flow in proportion to the difference of temperature"
    parameter Real G(unit = "W/K", min = 0) = 1 "Conductance";
    HeatPort port_a;
    HeatPort port_b;
  equation
    port_a.Q = G * (port_a.T - port_b.T);
    port_a.Q + port_b.Q = 0;
  end Conductor;

  model Surroundings "Constant temperature"
    parameter Real T(unit = "K") = 293.15 "Temperature";
    HeatPort port;
  equation
    port.T = T;
  end Surroundings;

  model Source "Heat flow given by a signal"
    input Real P(unit = "W") "Heat flow into what is connected";
    HeatPort port;
  equation
    port.Q = -P;
  end Source;

  model Oven "A heater that warms a plate, which loses heat to the room"
    input Real P(unit = "W") "Electrical power of the heater";
    output Real T_heater(unit = "K") "Temperature of the heater, as measured";
    output Real T_plate(unit = "K") "Temperature of the plate, as measured";
    Source source(P = P);
    Body heater(C = 300, T(start = 400));
    Body plate(C = 900, T(start = 360));
    Conductor wall(G = 1.5);
    Conductor skin(G = 0.8);
    Surroundings room;
  equation
    connect(source.port, heater.port);
    connect(heater.port, wall.port_a);
    connect(wall.port_b, plate.port);
    connect(plate.port, skin.port_a);
    connect(skin.port_b, room.port);
    T_heater = heater.T;
    T_plate = plate.T;
  end Oven;
end Rig;
