within ;
package Laws "What a model may lack: general laws, by what they act on"
  annotation (
    version = "1.0.0",
    Documentation(info = "<html>
<p>Each law extends the partial model of its kind in <b>Interfaces</b> and vanishes where its first own parameter has its default. No other library is needed. To
add a law, write such a model in a package of your own:</p>
<ul>
<li>The first parameter that the law declares switches it off at its default; the others are its shape.</li>
<li><code>min</code>, <code>max</code> and <code>nominal</code> are written in the port's sizes, such as <code>0.1 * f_n / v_n</code>. <code>nominal</code> is where a search starts, and its sizes
give the parameter's unit. The sizes (<code>f_n</code>, <code>v_n</code>, ...) are set to the largest magnitudes that occur; <code>t_n</code> is the time in which the port's signals change.</li>
<li>Widths of rounding are protected expressions in the sizes.</li>
<li><code>annotation (__aero_bayes(refines = \"coulomb_friction\"))</code> marks a finer law of another one, <code>__aero_bayes(not_for = \"K A\")</code> one that makes no sense
for a temperature, nor where a current flows.</li>
<li><code>__aero_bayes(both_signs = \"v\")</code> marks a law that only a signal of both signs shows, <code>__aero_bayes(nonnegative = \"h\")</code> one that only a signal
that never falls below zero can have, <code>__aero_bayes(absolute = \"v\")</code> one that needs the motion of one body,
<code>__aero_bayes(threshold = \"r\")</code> one that acts only beyond <code>r</code>, <code>__aero_bayes(learned = \"v\")</code> a curve over <code>v</code>, <code>__aero_bayes(delay = \"T_d\")</code> one that delays its input by <code>T_d</code> and does nothing else.</li>
<li><code>__aero_bayes(memory = \"rate_limit\")</code> or <code>\"play\"</code> marks a law of these two, by the parameters of <b>Inputs.RateLimit</b> or <b>Inputs.Hysteresis</b>
in their order: a search applies it to the recorded input without its rounding. <code>__aero_bayes(memory = \"delay\")</code> marks a law that delays a reading by
its only parameter: a search reads a state as it was before, exactly.</li>
<li>The law's id is the model's name in snake case: <code>CoulombFriction</code> is <code>coulomb_friction</code>.</li>
</ul>
</html>"));
end Laws;
