within Laws.Storage;
model Exchange "A flow between two storages by their difference"
  extends Laws.Interfaces.ExchangeLaw;
  parameter Real k(min = 0, max = 10 * q_n / d_n, nominal = 0.1 * q_n / d_n) = 0 "Flow for each unit of difference";
equation
  q = k * (h_1 - h_2);
  annotation (Documentation(info = "<html>
<p>A connecting pipe, a wall that conducts heat, a resistor between two capacitors.</p>
<p>Source: J. Fourier, Th&eacute;orie analytique de la chaleur (1822).</p>
</html>"));
end Exchange;
