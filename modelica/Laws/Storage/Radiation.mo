within Laws.Storage;
model Radiation "Heat lost by radiation"
  extends Laws.Interfaces.StorageLaw(h(unit = "K"));
  parameter Real c(min = 0, max = 10 * q_n / (h_n + h_0 - h_z) ^ 4, nominal = 0.1 * q_n / (h_n + h_0 - h_z) ^ 4) = 0 "Radiated heat at a temperature of one kelvin";
equation
  q = c * ((h - h_z) ^ 4 - (h_s - h_z) ^ 4);
  annotation (Documentation(info = "<html>
<p><code>c (T^4 - T_0^4)</code> to surroundings at <code>h_s</code>, counted from the absolute zero <code>h_z</code>.</p>
<p>Source: J. Stefan, &Uuml;ber die Beziehung zwischen der W&auml;rmestrahlung und der Temperatur (1879); L. Boltzmann (1884).</p>
</html>"));
end Radiation;
