"""Balances as control engineers write them, in vectors, in loops, in arrays of components: one port for each row."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.random import Generator
from small_rigs import Numbers, explicit, rig, somewhere
from written_laws import agree

from aero_bayes.laws.attach import LawBlocks
from aero_bayes.laws.balance import Port
from aero_bayes.laws.candidates import Candidate, place_law, ports_with_laws
from aero_bayes.laws.law import Law
from aero_bayes.laws.write_model import reserved_names
from aero_bayes.modelica.flat import FlatModel
from aero_bayes.modelica.rumoca_front import load_flat

ARM = """model Arm "Two joints; {how}"
  parameter Real a = 0.3, b = 0.05, c = 0.02, d[2](each unit = "N.m.s/rad") = {{0.1, 0.2}};
  input Real tau(unit = "N.m");
  output Real y(unit = "rad") = q[1];
  Real q[2](each unit = "rad", each start = 0, each fixed = true);
  Real v[2](each unit = "rad/s", each start = 0, each fixed = true);
  Real M[2, 2](each unit = "kg.m2") = [a, b * cos(q[2]); b * cos(q[2]), c];
  Real h[2](each unit = "N.m") = {{b * sin(q[1]) * v[2]^2, c * sin(q[2])}};
equation
  der(q) = v;
  {balance}
end Arm;
"""
ARMS = {
    "on the left": ("M * der(v) + h + d .* v = {tau, 0};", "+ {0, d_v_2 * v[2]} = {tau, 0};"),
    "in the element": (
        "M * der(v) = {tau - h[1] - d[1] * v[1], -h[2] - d[2] * v[2]};", "-h[2] - d[2] * v[2] - d_v_2 * v[2]};",
    ),
    "beside a vector": ("M * der(v) = {tau, 0} - h - diagonal(d) * v;", "- {0, d_v_2 * v[2]};"),
    "negative": ("-M * der(v) = h - {tau, 0} + d .* v;", "+ d .* v + {0, d_v_2 * v[2]};"),
    "solved": (
        "der(v) = Modelica.Math.Matrices.solve(M, {tau, 0} - h - d .* v);", "h - d .* v - {0, d_v_2 * v[2]});",
    ),
}  # fmt: skip
#: Stands for the library's function, which calls LAPACK.
LIBRARY = """package Modelica
  package Math
    package Matrices
      function solve
        input Real A[:, size(A, 1)];
        input Real b[size(A, 1)];
        output Real x[size(b, 1)];
        external "FORTRAN 77" dgesv(A, b, x);
      end solve;
    end Matrices;
  end Math;
end Modelica;
"""


def added(
    model: str,
    sources: Sequence[Path],
    port: Port,
    laws: Sequence[Law],
    blocks: LawBlocks,
    folder: Path,
    rng: Generator,
) -> tuple[dict[str, float], dict[str, float], str]:
    """A point, what viscous friction or a linear loss of 0.7 changes there in the rates, and the written text.

    The model with the law attached says the same as the written one.
    """
    flat = rig(model, *map(str, sources))
    law = next(law for law in laws if law.id in ("viscous_friction", "linear_loss") and law.id in port.laws)
    placed = place_law(Candidate(law, port), reserved_names(flat, sources), values={law.magnitude.name: 0.7})
    written = agree(model, list(sources), [placed], blocks, folder, rng)
    again = Numbers(explicit(load_flat(written.name, [*sources, written.path])))
    base = Numbers(explicit(flat))
    point = somewhere(base.names(), rng)
    before, after = base(point), again(point)
    return point, {k: after[k] - before[k] for k in before}, written.text


@pytest.mark.parametrize("how", ARMS)
@pytest.mark.parametrize("joint", [1, 2])
def test_a_torque_at_a_joint_moves_all_joints_by_the_mass_matrix(how, joint, laws, blocks, tmp_path, rng):
    balance, expected = ARMS[how]
    sources = [tmp_path / "Arm.mo", tmp_path / "Modelica.mo"]
    sources[0].write_text(ARM.format(how=how, balance=balance), encoding="utf-8")
    sources[1].write_text(LIBRARY, encoding="utf-8")
    ports = {p.id: p for p in ports_with_laws(rig("Arm", *map(str, sources)), laws)}
    assert list(ports) == ["tau", "y", "v[1]", "v[2]"]
    port = ports[f"v[{joint}]"]
    assert (port.kind, port.unit, dict(port.signals)) == ("motion", "N.m", {"v": port.id, "x": f"q[{joint}]"})
    at, change, text = added("Arm", sources, port, laws, blocks, tmp_path / "out", rng)
    coupling = 0.05 * np.cos(at["q[2]"])
    torque = np.zeros(2)
    torque[joint - 1] = -0.7 * at[port.id]
    rates = np.linalg.solve([[0.3, coupling], [coupling, 0.02]], torque)
    assert [change["der(v[1])"], change["der(v[2])"]] == pytest.approx(rates, rel=1e-9)
    assert joint == 1 or expected in text.replace("  ", " ")


CHAIN = """model Chain
  parameter Integer n = {n};
  parameter Real C[n](each unit = "J/K") = linspace(2, 4, n), G(unit = "W/K") = 0.5;
  input Real P(unit = "W");
  output Real y(unit = "K") = T[n];
  Real T[n](each unit = "K", each start = 290, each fixed = true);
  Real Q[n + 1](each unit = "W");
equation
  Q[1] = P;
  for i in 1:n - 1 loop
    Q[i + 1] = G * (T[i] - T[i + 1]);
  end for;
  Q[n + 1] = 0;
  {balance}
end Chain;
"""


@pytest.mark.parametrize(
    ("n", "balance", "expected"),
    [
        (3, "for i in 1:n loop\n    der(T[i]) = (Q[i] - Q[i + 1]) / C[i];\n  end for;", "if i == 2 then"),
        (3, "for k in 2:n + 1 loop\n    C[k - 1] * der(T[k - 1]) = Q[k - 1] - Q[k];\n  end for;", "if k == 3 then"),
        (3, "der(T) = (Q[1:n] - Q[2:n + 1]) ./ C;", "{0, k * (T[2] - 0), 0}) ./ C"),
        (
            8,
            "diagonal(C) * der(T) = Q[1:n] - Q[2:n + 1];",
            "{if row_k == 2 then k * (T[2] - 0) else 0 for row_k in 1:8}",
        ),
    ],
)
def test_a_loss_of_one_element_of_a_loop_or_a_vector(n, balance, expected, laws, blocks, modelica, tmp_path, rng):
    path = modelica(CHAIN.format(n=n, balance=balance))
    ports = {p.id: p for p in ports_with_laws(rig("Chain", str(path)), laws)}
    assert list(ports) == ["P", "y", *(f"T[{k + 1}]" for k in range(n))]
    at, change, text = added("Chain", [path], ports["T[2]"], laws, blocks, tmp_path / "out", rng)
    assert ports["T[2]"].unit == "W"
    capacity = np.linspace(2, 4, n)[1]
    moved = {k: v for k, v in change.items() if abs(v) > 1e-12}
    assert moved == pytest.approx({"der(T[2])": -0.7 * at["T[2]"] / capacity}, rel=1e-9)
    assert expected in text


def test_one_of_an_array_of_components(laws, blocks, modelica, tmp_path, rng):
    path = modelica(
        """model Vessel
  parameter Real A(unit = "m2") = 2;
  input Real q(unit = "m3/s");
  Real h(unit = "m", start = 1, fixed = true);
equation
  A * der(h) = q - 0.1 * h;
end Vessel;

model Plant
  input Real u(unit = "m3/s");
  output Real y(unit = "m") = tank[2].h;
  Vessel tank[2];
equation
  tank[1].q = u;
  tank[2].q = 0.1 * tank[1].h;
end Plant;
""",
        "Plant",
    )
    ports = {p.id: p for p in ports_with_laws(rig("Plant", str(path)), laws)}
    at, change, text = added("Plant", [path], ports["tank[2].h"], laws, blocks, tmp_path / "out", rng)
    moved = {k: v for k, v in change.items() if v != 0.0}
    assert moved == pytest.approx({"der(tank[2].h)": -0.7 * at["tank[2].h"] / 2})
    assert "Vessel_tank tank[2](linear_loss_q = {0, linear_loss.q});" in text


def test_a_state_space_model_has_motions_where_a_row_is_a_speed(laws, modelica):
    path = modelica("""model Space
  parameter Real k = 4, d = 0.5;
  parameter Real A[2, 2] = [0, 1; -k, -d];
  input Real u;
  output Real y = x[1];
  Real x[2](each start = 0, each fixed = true);
equation
  der(x) = A * x + {0, 1} * u;
end Space;
""")
    flat: FlatModel = rig("Space", str(path))
    (port,) = (p for p in ports_with_laws(flat, laws) if p.kind not in ("input", "output"))
    assert (port.id, port.kind, dict(port.signals)) == ("x[2]", "motion", {"v": "x[2]", "x": "x[1]"})
