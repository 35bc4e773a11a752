"""The loop on the page: its candidates, and the equation with the term that was added."""

from __future__ import annotations

import re

import pytest

from aero_bayes.loop.result import LoopJson, Step, StepCandidate
from aero_bayes.report.loop_figures import changed_equations, rounds_table

pytestmark = pytest.mark.fast


def rounds_of(shares: dict[str, float]) -> LoopJson:
    candidates = [StepCandidate(id=id_, port="v", share=share, share_sd=0.01) for id_, share in shares.items()]
    return LoopJson(outcome="extended", steps=[Step(round=1, candidates=candidates, chosen="a")])


def test_the_bar_of_a_candidate_is_as_long_as_the_error_falls() -> None:
    table = str(rounds_table(rounds_of({"a": 0.25, "b": 0.95, "c": 1.2}), {}))
    bars = re.findall(r'class="bar"[^>]*width="([\d.]+)"', table)
    track = float(re.findall(r'class="track"[^>]*width="([\d.]+)"', table)[0])
    assert [float(width) / track for width in bars] == pytest.approx([0.75, 0.05, 0.0], abs=0.001)


def test_the_added_term_is_marked_in_its_equation() -> None:
    source = "model R\n  Real f;\nequation\n  der(x) = v;\n  m*der(v) = F - d*v - f;\n  f = c*sign(v);\nend R;\n"
    diff = "@@ -2 +2 @@\n-  Real x;\n+  Real f;\n equation\n   der(x) = v;\n-  m*der(v) = F - d*v;\n" \
        "+  m*der(v) = F - d*v - f;\n+  f = c*sign(v);\n"  # fmt: skip
    loop = LoopJson(outcome="extended", diff=diff, modelica_source=source)
    assert changed_equations(loop) == "m*der(v) = F - d*v<mark> - f</mark>;\n<mark>f = c*sign(v);</mark>"
    assert changed_equations(LoopJson(outcome="adequate")) is None


def test_a_laws_own_equations_and_documentation_are_none_of_the_models() -> None:
    law = ["  model L", "  initial equation", "    z = u;", "  equation", "    der(z) = u - z;"]
    law += ["    annotation (Documentation(", '    info = "<p>It follows the input.</p>"));', "  end L;"]
    law += ["  L l(u = x);", "equation", "  y = l.z;"]
    diff = "\n".join(["-model R", "-  Real x;", "+model R_lag", *("+" + line for line in law)])
    loop = LoopJson(outcome="extended", diff=diff, modelica_source="\n".join(["model R_lag", *law, "end R_lag;"]))
    assert re.sub("</?mark>", "", str(changed_equations(loop))) == "y = l.z;"
