within ;
package MslModels "Small models on components of the Modelica Standard Library"

  model Blocks3 "PID with feedback"
    Modelica.Blocks.Sources.Ramp ramp(duration = 0.5, height = 2);
    Modelica.Blocks.Math.Feedback feedback;
    Modelica.Blocks.Continuous.PID pid(k = 2, Ti = 0.5, Td = 0.05);
    Modelica.Blocks.Continuous.FirstOrder plant(T = 0.3, k = 1.5);
    output Real y = plant.y;
  equation
    connect(ramp.y, feedback.u1);
    connect(plant.y, feedback.u2);
    connect(feedback.y, pid.u);
    connect(pid.y, plant.u);
  end Blocks3;
  model Blocks5 "transfer function and state space"
    Modelica.Blocks.Sources.Trapezoid source(period = 1, amplitude = 2, rising = 0.1, width = 0.3, falling = 0.1);
    Modelica.Blocks.Continuous.TransferFunction tf(b = {1, 2}, a = {0.1, 0.5, 1});
    Modelica.Blocks.Continuous.StateSpace ss(A = [-1, 2; -3, -4], B = [0; 1], C = [1, 1], D = [0]);
    output Real y = tf.y, z = ss.y[1];
  equation
    connect(source.y, tf.u);
    connect(tf.y, ss.u[1]);
  end Blocks5;
  model Blocks6 "switch and hysteresis"
    Modelica.Blocks.Sources.Sine source(amplitude = 1, f = 1);
    Modelica.Blocks.Logical.Hysteresis hysteresis(uLow = -0.5, uHigh = 0.5);
    Modelica.Blocks.Sources.Constant up(k = 1), down(k = -2);
    Modelica.Blocks.Logical.Switch switch;
    Modelica.Blocks.Continuous.FirstOrder first(T = 0.2);
    output Real y = first.y;
  equation
    connect(source.y, hysteresis.u);
    connect(hysteresis.y, switch.u2);
    connect(up.y, switch.u1);
    connect(down.y, switch.u3);
    connect(switch.y, first.u);
  end Blocks6;
  model Blocks7 "table"
    Modelica.Blocks.Tables.CombiTable1Ds table(table = [0, 0; 0.5, 1; 1, 0.2; 2, 3]);
    Modelica.Blocks.Sources.Ramp ramp(height = 2, duration = 1);
    Modelica.Blocks.Continuous.FirstOrder first(T = 0.1);
    output Real y = first.y;
  equation
    connect(ramp.y, table.u);
    connect(table.y[1], first.u);
  end Blocks7;

  model Analog2 "DC motor"
    Modelica.Electrical.Analog.Sources.ConstantVoltage source(V = 12);
    Modelica.Electrical.Analog.Basic.Resistor r(R = 1);
    Modelica.Electrical.Analog.Basic.Inductor l(L = 0.01);
    Modelica.Electrical.Analog.Basic.RotationalEMF emf(k = 0.1);
    Modelica.Electrical.Analog.Basic.Ground ground;
    Modelica.Mechanics.Rotational.Components.Inertia rotor(J = 1e-3, w(start = 0, fixed = true), phi(start = 0, fixed = true));
    Modelica.Mechanics.Rotational.Components.Damper damper(d = 1e-3);
    Modelica.Mechanics.Rotational.Components.Fixed fixed;
    output Real w = rotor.w, i = l.i;
  equation
    connect(source.p, r.p);
    connect(r.n, l.p);
    connect(l.n, emf.p);
    connect(emf.n, ground.p);
    connect(source.n, ground.p);
    connect(emf.flange, rotor.flange_a);
    connect(rotor.flange_b, damper.flange_a);
    connect(damper.flange_b, fixed.flange);
  end Analog2;
  model Analog3 "two capacitors in parallel"
    Modelica.Electrical.Analog.Sources.SineVoltage source(V = 2, f = 1);
    Modelica.Electrical.Analog.Basic.Resistor r(R = 5);
    Modelica.Electrical.Analog.Basic.Capacitor c1(C = 0.01, v(start = 0.5, fixed = true)), c2(C = 0.02);
    Modelica.Electrical.Analog.Basic.Ground ground;
    output Real y = c2.v, z = c1.i;
  equation
    connect(source.p, r.p);
    connect(r.n, c1.p);
    connect(r.n, c2.p);
    connect(c1.n, ground.p);
    connect(c2.n, ground.p);
    connect(source.n, ground.p);
  end Analog3;
  model Analog4 "diode with an exponential"
    Modelica.Electrical.Analog.Sources.SineVoltage source(V = 2, f = 1);
    Modelica.Electrical.Analog.Basic.Resistor r(R = 100);
    Modelica.Electrical.Analog.Semiconductors.Diode diode;
    Modelica.Electrical.Analog.Basic.Capacitor c(C = 1e-3, v(start = 0, fixed = true));
    Modelica.Electrical.Analog.Basic.Resistor load(R = 1000);
    Modelica.Electrical.Analog.Basic.Ground ground;
    output Real y = c.v;
  equation
    connect(source.p, r.p);
    connect(r.n, diode.p);
    connect(diode.n, c.p);
    connect(c.p, load.p);
    connect(c.n, ground.p);
    connect(load.n, ground.p);
    connect(source.n, ground.p);
  end Analog4;
  model Analog5 "ideal diode"
    Modelica.Electrical.Analog.Sources.SineVoltage source(V = 5, f = 1);
    Modelica.Electrical.Analog.Basic.Resistor r(R = 10);
    Modelica.Electrical.Analog.Ideal.IdealDiode diode(Vknee = 0, Ron = 1e-5, Goff = 1e-5);
    Modelica.Electrical.Analog.Basic.Capacitor c(C = 0.01, v(start = 0, fixed = true));
    Modelica.Electrical.Analog.Basic.Resistor load(R = 100);
    Modelica.Electrical.Analog.Basic.Ground ground;
    output Real y = c.v;
  equation
    connect(source.p, r.p);
    connect(r.n, diode.p);
    connect(diode.n, c.p);
    connect(c.p, load.p);
    connect(c.n, ground.p);
    connect(load.n, ground.p);
    connect(source.n, ground.p);
  end Analog5;

  model Rotational2 "ideal gear"
    Modelica.Mechanics.Rotational.Sources.ConstantTorque torque(tau_constant = 2);
    Modelica.Mechanics.Rotational.Components.Inertia j1(J = 0.1, phi(start = 0, fixed = true), w(start = 1, fixed = true));
    Modelica.Mechanics.Rotational.Components.IdealGear gear(ratio = 4);
    Modelica.Mechanics.Rotational.Components.Inertia j2(J = 2);
    Modelica.Mechanics.Rotational.Components.Damper damper(d = 0.5);
    Modelica.Mechanics.Rotational.Components.Fixed fixed;
    output Real y = j2.w, z = j1.phi;
  equation
    connect(torque.flange, j1.flange_a);
    connect(j1.flange_b, gear.flange_a);
    connect(gear.flange_b, j2.flange_a);
    connect(j2.flange_b, damper.flange_a);
    connect(damper.flange_b, fixed.flange);
  end Rotational2;
  model Rotational3 "backlash"
    Modelica.Mechanics.Rotational.Sources.Torque torque;
    Modelica.Blocks.Sources.Sine source(amplitude = 2, f = 1);
    Modelica.Mechanics.Rotational.Components.Inertia j1(J = 0.1, phi(start = 0, fixed = true), w(start = 0, fixed = true));
    Modelica.Mechanics.Rotational.Components.ElastoBacklash backlash(c = 100, d = 0.5, b = 0.1);
    Modelica.Mechanics.Rotational.Components.Inertia j2(J = 0.2, phi(start = 0, fixed = true), w(start = 0, fixed = true));
    output Real y = j2.phi;
  equation
    connect(source.y, torque.tau);
    connect(torque.flange, j1.flange_a);
    connect(j1.flange_b, backlash.flange_a);
    connect(backlash.flange_b, j2.flange_a);
  end Rotational3;
  model Rotational4 "friction of a bearing"
    Modelica.Mechanics.Rotational.Sources.Torque torque;
    Modelica.Blocks.Sources.Sine source(amplitude = 12, f = 0.5);
    Modelica.Mechanics.Rotational.Components.Inertia j(J = 1, phi(start = 0, fixed = true), w(start = 0, fixed = true));
    Modelica.Mechanics.Rotational.Components.BearingFriction friction(tau_pos = [0, 5; 1, 6], peak = 1.1);
    output Real y = j.w;
  equation
    connect(source.y, torque.tau);
    connect(torque.flange, j.flange_a);
    connect(j.flange_b, friction.flange_a);
  end Rotational4;

  model Translational2 "rack and pinion"
    Modelica.Mechanics.Rotational.Sources.ConstantTorque torque(tau_constant = 1);
    Modelica.Mechanics.Rotational.Components.Inertia j(J = 0.1, phi(start = 0, fixed = true), w(start = 0, fixed = true));
    Modelica.Mechanics.Rotational.Components.IdealGearR2T rack(ratio = 20);
    Modelica.Mechanics.Translational.Components.Mass mass(m = 3);
    Modelica.Mechanics.Translational.Components.Damper damper(d = 10);
    Modelica.Mechanics.Translational.Components.Fixed fixed;
    output Real y = mass.v;
  equation
    connect(torque.flange, j.flange_a);
    connect(j.flange_b, rack.flangeR);
    connect(rack.flangeT, mass.flange_a);
    connect(mass.flange_b, damper.flange_a);
    connect(damper.flange_b, fixed.flange);
  end Translational2;
  model Translational3 "gap with spring"
    Modelica.Mechanics.Translational.Components.Mass mass(m = 1, s(start = 1, fixed = true), v(start = -3, fixed = true));
    Modelica.Mechanics.Translational.Components.ElastoGap gap(c = 500, d = 5, s_rel0 = 0.2);
    Modelica.Mechanics.Translational.Components.Fixed fixed;
    output Real y = mass.s;
  equation
    connect(fixed.flange, gap.flange_a);
    connect(gap.flange_b, mass.flange_a);
  end Translational3;

  model Heat1 "two bodies"
    Modelica.Thermal.HeatTransfer.Components.HeatCapacitor c1(C = 10, T(start = 350, fixed = true)), c2(C = 20, T(start = 300, fixed = true));
    Modelica.Thermal.HeatTransfer.Components.ThermalConductor g(G = 5);
    output Real y = c1.T, z = c2.T;
  equation
    connect(c1.port, g.port_a);
    connect(g.port_b, c2.port);
  end Heat1;
  model Heat3 "controlled heater"
    Modelica.Thermal.HeatTransfer.Components.HeatCapacitor c(C = 20, T(start = 290, fixed = true));
    Modelica.Thermal.HeatTransfer.Components.ThermalResistor resistor(R = 0.5);
    Modelica.Thermal.HeatTransfer.Sources.FixedTemperature ambient(T = 280);
    Modelica.Thermal.HeatTransfer.Sources.PrescribedHeatFlow heater;
    Modelica.Thermal.HeatTransfer.Sensors.TemperatureSensor sensor;
    Modelica.Blocks.Logical.OnOffController controller(bandwidth = 2);
    Modelica.Blocks.Sources.Constant reference(k = 300);
    Modelica.Blocks.Logical.Switch switch;
    Modelica.Blocks.Sources.Constant on(k = 100), off(k = 0);
    output Real y = c.T;
  equation
    connect(c.port, resistor.port_a);
    connect(resistor.port_b, ambient.port);
    connect(heater.port, c.port);
    connect(sensor.port, c.port);
    connect(reference.y, controller.reference);
    connect(sensor.T, controller.u);
    connect(controller.y, switch.u2);
    connect(on.y, switch.u1);
    connect(off.y, switch.u3);
    connect(switch.y, heater.Q_flow);
  end Heat3;
  model Heat4 "resistor that heats"
    Modelica.Electrical.Analog.Sources.SineVoltage source(V = 10, f = 1);
    Modelica.Electrical.Analog.Basic.Resistor r(R = 5, alpha = 0.004, useHeatPort = true, T_ref = 293.15);
    Modelica.Electrical.Analog.Basic.Inductor l(L = 0.2, i(start = 0, fixed = true));
    Modelica.Electrical.Analog.Basic.Ground ground;
    Modelica.Thermal.HeatTransfer.Components.HeatCapacitor c(C = 2, T(start = 293.15, fixed = true));
    Modelica.Thermal.HeatTransfer.Components.ThermalConductor g(G = 0.1);
    Modelica.Thermal.HeatTransfer.Sources.FixedTemperature ambient(T = 293.15);
    output Real y = c.T, i = l.i;
  equation
    connect(source.p, r.p);
    connect(r.n, l.p);
    connect(l.n, ground.p);
    connect(source.n, ground.p);
    connect(r.heatPort, c.port);
    connect(c.port, g.port_a);
    connect(g.port_b, ambient.port);
  end Heat4;

  model Magnetic3 "air gap of a given shape"
    Modelica.Electrical.Analog.Sources.SineVoltage source(V = 4, f = 2);
    Modelica.Electrical.Analog.Basic.Resistor r(R = 2);
    Modelica.Electrical.Analog.Basic.Ground ground;
    Modelica.Magnetic.FluxTubes.Basic.ElectroMagneticConverter coil(N = 80);
    Modelica.Magnetic.FluxTubes.Shapes.FixedShape.Cuboid gap(l = 0.002, a = 0.02, b = 0.02, nonLinearPermeability = false, mu_rConst = 1);
    Modelica.Magnetic.FluxTubes.Basic.Ground magnetic;
    output Real y = coil.i, z = gap.B;
  equation
    connect(source.p, r.p);
    connect(r.n, coil.p);
    connect(coil.n, ground.p);
    connect(source.n, ground.p);
    connect(coil.port_p, gap.port_p);
    connect(gap.port_n, coil.port_n);
    connect(coil.port_n, magnetic.port);
  end Magnetic3;
  model Magnetic4 "iron that saturates"
    Modelica.Electrical.Analog.Sources.SineVoltage source(V = 8, f = 1);
    Modelica.Electrical.Analog.Basic.Resistor r(R = 2);
    Modelica.Electrical.Analog.Basic.Ground ground;
    Modelica.Magnetic.FluxTubes.Basic.ElectroMagneticConverter coil(N = 100);
    Modelica.Magnetic.FluxTubes.Shapes.FixedShape.Cuboid core(l = 0.2, a = 0.02, b = 0.02, material = Modelica.Magnetic.FluxTubes.Material.SoftMagnetic.Steel.Steel_9SMnPb28());
    Modelica.Magnetic.FluxTubes.Basic.Ground magnetic;
    output Real y = coil.i, z = core.B;
  equation
    connect(source.p, r.p);
    connect(r.n, coil.p);
    connect(coil.n, ground.p);
    connect(source.n, ground.p);
    connect(coil.port_p, core.port_p);
    connect(core.port_n, coil.port_n);
    connect(coil.port_n, magnetic.port);
  end Magnetic4;
end MslModels;
