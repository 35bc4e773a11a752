within Laws.Outputs;
model Unsigned "A reading that does not tell the sign"
  extends Laws.Interfaces.OutputLaw;
  parameter Real r(min = 0, max = 2, nominal = 1) = 0 "Share of what is below zero that is read as above it";
protected
  final parameter Real u_smooth = 1e-3 * u_n "Width of the rounding at zero";
equation
  y = u + r * (sqrt(u ^ 2 + u_smooth ^ 2) - u);
  annotation (__aero_bayes(not_for = "K", nonnegative = "u"),
    Documentation(info = "<html>
<p><code>|u|</code> for <code>r = 1</code>, rounded at zero: a pulse counter sees how fast a shaft turns and not which way.</p>
<p>Source: T. Wigren, M. Schoukens, Coupled Electric Drives Data Set and Reference Models, Uppsala University, Technical Report 2017-024.</p>
</html>"));
end Unsigned;
