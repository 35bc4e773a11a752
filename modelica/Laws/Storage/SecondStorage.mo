within Laws.Storage;
model SecondStorage "A second storage behind a conductance"
  extends Laws.Interfaces.StorageLaw;
  parameter Real k_2(min = 0, max = 100 * q_n / h_n, nominal = 0.3 * q_n / h_n) = 0 "Flow into the second storage for each unit of difference";
  parameter Real T_2(min = 0.1 * t_n, max = 1000 * t_n, nominal = 3 * t_n) = 3 * t_n "Time constant of the second storage, its capacity over the conductance";
  parameter Real start_h_2(min = -10 * h_n, max = 10 * h_n, nominal = h_n) = 0 "Level of the second storage at the start, beyond that of the storage";
  Real h_2(nominal = h_n) "Level of the second storage";
initial equation
  h_2 = h + start_h_2;
equation
  T_2 * der(h_2) = h - h_2;
  q = k_2 * (h - h_2);
  annotation (__aero_bayes(not_for = "C A.s A.h"), Documentation(info = "<html>
<p>The capacity is <code>C_2 = k_2 T_2</code>: <code>C_2 dh_2/dt = k_2 (h - h_2)</code>. Walls and furniture behind the air of a room, the casing around a winding,
a side chamber behind a narrow pipe, a slow charge in a capacitor. It starts at the level of the storage, or <code>start_h_2</code> above it. A
charge is no level.</p>
<p>Source: P. Bacher, H. Madsen, Identifying suitable models for the heat dynamics of buildings, Energy and Buildings 43 (2011), 1511-1522.</p>
</html>"));
end SecondStorage;
