"""What the page says of intervals over several structures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from aero_bayes.report import RunDirectory
from aero_bayes.report.loop_evidence import averaged_table, structures_words
from aero_bayes.schema import LoopJson, RunJson

CHOSEN = {"sd": 0.1, "q05": 1.0, "q50": 1.2, "q95": 1.4}
MIXTURE = {"sd": 0.3, "q05": 0.6, "q50": 1.1, "q95": 1.6}


def run(**more: Any) -> RunDirectory:
    averaged = {
        "structures": [{"terms": ["lag@u"], "wins": 0.71}, {"terms": ["delay@y"], "wins": 0.29}],
        "parameters": {"k": {"chosen": CHOSEN, "mixture": MIXTURE}, "d": {"chosen": CHOSEN, "mixture": MIXTURE}},
    }
    parameters = {"k": {"value": 1.2, **MIXTURE, "unit": "N/m"}, "d": {"value": 3.0, "status": "at_bound"}}
    loop = {"outcome": "extended", "averaged": averaged, **more}
    return RunDirectory(Path(), RunJson.model_validate({"parameters": parameters, "loop": loop}), {}, {})


def loop_of(directory: RunDirectory) -> LoopJson:
    assert directory.result.loop is not None
    return directory.result.loop


def test_structures_are_named_with_how_often_each_wins() -> None:
    words = structures_words(loop_of(run()))
    assert "lag@u (best in 71 %)" in words
    assert "delay@y (best in 29 %)" in words
    assert structures_words(loop_of(run(averaged=None))) == ""


def test_the_table_has_both_intervals_of_each_parameter_that_has_one() -> None:
    directory = run()
    table = averaged_table(directory, loop_of(directory))
    assert table is not None
    for text in ("1.00 … 1.40", "0.60 … 1.60", "2.5"):
        assert text in table, table
    assert table.count("<tr") == 2  # its head, and k; d ended on a bound
    assert averaged_table(run(averaged=None), loop_of(run(averaged=None))) is None
