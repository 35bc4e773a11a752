"""The shipped package through a second, unrelated Modelica front end: pymoca flattens it, CasADi evaluates it."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from aero_bayes.modelica.embedded import explicit_model
from aero_bayes.modelica.expression import evaluate_nodes
from aero_bayes.modelica.library import modelica_root

api = pytest.importorskip("pymoca.backends.casadi.api", reason="the second front end, pymoca, is not installed")
casadi = pytest.importorskip("casadi", reason="the second front end evaluates with CasADi, which is not installed")


def without_annotations(text: str) -> str:
    """The class without annotations: they are most of the text, and pymoca reads slowly."""
    text = re.sub(r"//[^\n]*|^within[^;]*;", "", text)
    while (match := re.search(r"\bannotation\s*\(", text)) is not None:
        depth, at, quoted = 1, match.end(), False
        while depth:
            if text[at] == '"' and text[at - 1] != "\\":
                quoted = not quoted
            elif not quoted:
                depth += {"(": 1, ")": -1}.get(text[at], 0)
            at += 1
        before, after = text[: match.start()].rstrip(), text[at:]
        # an annotation of a class ends with a semicolon of its own
        text = before + (after.lstrip()[1:] if before.endswith(";") else after)
    return text


@pytest.fixture(scope="module")
def one_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = modelica_root() / "Aero"
    lines = ["package Aero"]
    for package in (root / "package.order").read_text(encoding="utf-8").split():
        lines.append(f"package {package}")
        for name in (root / package / "package.order").read_text(encoding="utf-8").split():
            lines.append(without_annotations((root / package / f"{name}.mo").read_text(encoding="utf-8")))
        lines.append(f"end {package};")
    folder = tmp_path_factory.mktemp("pymoca")
    (folder / "Aero.mo").write_text("\n".join([*lines, "end Aero;"]), encoding="utf-8")
    return folder


@pytest.mark.parametrize("name", ["OneDof", "HalfQuadLinear"])
def test_the_same_rates_from_both_front_ends(one_file, name):
    full = f"Aero.Systems.{name}"
    other = api.transfer_model(str(one_file), full, {"replace_parameter_expressions": True, "cache": False})
    mine = explicit_model(full)
    b = mine.system.builder
    rng = np.random.default_rng(11)
    free = {p.symbol.name(): p for p in other.parameters}
    unknown = casadi.vertcat(*(v.symbol for v in [*other.der_states, *other.alg_states]))
    given = [*other.states, *other.inputs, *other.parameters]
    constants = [c.symbol for c in other.constants]
    residual = casadi.Function(
        "residual",
        [unknown, casadi.vertcat(*(v.symbol for v in given), *constants)],
        [casadi.vertcat(*other.equations), casadi.jacobian(casadi.vertcat(*other.equations), unknown)],
    )
    assert {s.symbol.name() for s in other.states} == set(mine.states)
    for _ in range(5):
        values = {p.name: p.binding.value for p in mine.system.parameters if p.binding and p.binding.op == "const"}
        values |= {n: v * float(rng.uniform(0.5, 2)) for n, v in values.items() if "." not in n and n in free}
        values |= {s: float(rng.normal()) * (300.0 if s.endswith(".w") else 1.0) for s in mine.states}
        values["V_m"] = float(rng.uniform(-24, 24))
        numbers = []
        for v in given:
            n = v.symbol.name()
            numbers.append(values[n] if n in values else float(v.value))
        numbers += [float(c.value) for c in other.constants]
        solution = np.ones(unknown.numel())
        for _ in range(20):
            zero, matrix = residual(solution, numbers)
            solution = solution - np.linalg.solve(np.array(matrix), np.array(zero).ravel())
        theirs = dict(zip((s.symbol.name() for s in other.states), solution, strict=False))
        mine_now = evaluate_nodes(mine.rates, {b.symbol(n): v for n, v in values.items()})
        for state, rate in zip(mine.states, mine_now, strict=True):
            assert rate == pytest.approx(theirs[state], rel=1e-10, abs=1e-9), state
