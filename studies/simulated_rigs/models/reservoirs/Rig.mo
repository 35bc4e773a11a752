package Rig "Two reservoirs joined by a long pipe"
  connector Port "Head and flow of water"
    Real h(unit = "m") "Head";
    flow Real q(unit = "m3/s") "Flow into the component";
  end Port;

  model Reservoir "Upright vessel"
    parameter Real A(unit = "m2", min = 0) = 1 "Surface";
    Port port;
    Real h(unit = "m", start = 0.5, fixed = true) "Level";
  equation
    h = port.h;
    A * der(h) = port.q;
  end Reservoir;

  model Pipe "Laminar flow between two ports"
    parameter Real c(unit = "m2/s", min = 0) = 1 "Flow per head";
    Port port_a;
    Port port_b;
  equation
    port_a.q = c * (port_a.h - port_b.h);
    port_a.q + port_b.q = 0;
  end Pipe;

  model Outside "Free outflow"
    Port port;
  equation
    port.h = 0;
  end Outside;

  model Pump "Flow given by a signal"
    input Real q(unit = "m3/s") "Flow into what is connected";
    Port port;
  equation
    port.q = -q;
  end Pump;

  model Plant "A pump fills the first reservoir, the second runs out"
    input Real q(unit = "m3/s") "Flow of the pump";
    output Real level_1(unit = "m") "Level of the first, as measured";
    output Real level_2(unit = "m") "Level of the second, as measured";
    Pump pump(q = q);
    Reservoir first(A = 0.02, h(start = 0.9));
    Reservoir second(A = 0.04);
    Pipe pipe(c = 4e-4);
    Pipe outlet(c = 3e-4);
    Outside outside;
  equation
    connect(pump.port, first.port);
    connect(first.port, pipe.port_a);
    connect(pipe.port_b, second.port);
    connect(second.port, outlet.port_a);
    connect(outlet.port_b, outside.port);
    level_1 = first.h;
    level_2 = second.h;
  end Plant;
end Rig;
