"""What the loop names on real rigs if each number that decides is halved or doubled.

Structures are searched once for each rig of ``real_rigs/cases.toml``, as the program does. Then the structure is chosen
again under each changed number, fits without a block that exist already are kept. Numbers of the search itself are not
changed: each would need a search of its own. A rig is one row, kept as a JSON file in OUT/deciding_numbers.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import json
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import chdir, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import play_drive
from aero_bayes.check import residual_tests
from aero_bayes.cli import main as run_program
from aero_bayes.judge import choose, prediction, validation
from aero_bayes.judge.choice import Choice
from aero_bayes.loop import conclude, extend, loop, make_result
from aero_bayes.search import comparison
from real_rigs import RECORDINGS, RigCase, cases, copy_model, loop_arguments
from real_rigs_table import judge_names
from trial_runs import Row, code, markdown_table, write_summary


@dataclass(frozen=True)
class Number:
    """A number that decides: where it stands, and the two values that it is given in place of its own."""

    module: Any
    values: tuple[float, float]


#: ``min_share`` stands for a fall of the error by a quarter: an eighth, and a half. Counts stay whole numbers.
NUMBERS = {
    "min_share": Number(None, (0.875, 0.5)),
    "MIN_STANDARD_ERRORS": Number(comparison, (1.0, 4.0)),
    "MIN_BLOCKS": Number(comparison, (2, 10)),
    "FINALISTS": Number(choose, (6, 24)),
    "FIRST_BLOCKS_STRIDE": Number(choose, (2, 8)),
    "MAX_REFUSALS": Number(conclude, (1, 6)),
    "MIN_GROWTH_RATIO": Number(validation, (1.025, 1.1)),
    "SIGNIFICANT_DEVIATIONS": Number(prediction, (1.0, 4.0)),
    "MAX_GROWTH_RATIO": Number(validation, (1.5, 4.0)),
    "MAX_ERROR_RATIO": Number(validation, (0.95, 0.8)),
    "MAX_PREDICTION_DEVIATIONS": Number(validation, (2.0, 8.0)),
    "FALSE_ALARM_RATE": Number(residual_tests, (5e-4, 2e-3)),
    "MAX_FLOOR_RATIO": Number(residual_tests, (1.0, 4.0)),
}


def answers(context: Any, base: Any, choice: Choice, chooser: choose.Chooser) -> dict[str, Row]:
    """Return what is named under each changed number: ids and classes that are not told apart, by number and value."""
    # What the first choice had fitted besides is there from the beginning now: an answer on the edge may turn.
    choice, own = chooser.choose(choice.explored), chooser.settings
    plain, same = conclude.conclude(context, base, choice), _offered(choice)
    found = {"as it is": _answer(plain)}
    for name, number in NUMBERS.items():
        for value in number.values:
            with patch.object(number.module, name, value) if number.module else nullcontext():
                chooser.settings = own if number.module else replace(own, **{name: value})
                again = chooser.choose(choice.explored)
                judged_alike = number.module in (None, choose, comparison) and _offered(again) == same
                concluded = plain if judged_alike else conclude.conclude(context, base, again)
                found[f"{name} = {value:g}"] = _answer(concluded)
    chooser.settings = own
    return found


def _offered(choice: Choice) -> tuple[Any, ...]:
    """Return what unseen readings are asked about, in order."""
    told = choice.told()
    return told.structure, told.undecided, choice.near


def _answer(conclusion: Any) -> Row:
    return {
        "named": [effect.id for effect in conclusion.effects],
        "equivalent": [list(ids) for ids in make_result._equivalent(conclusion)],
    }


def run_case(case: RigCase, files: dict[str, list[Path]], out: Path, options: argparse.Namespace) -> Row:
    """Close the loop of a rig in this process, and choose again under each changed number."""
    copy_model(case, out)
    found: dict[str, Row] = {}
    choosers: list[choose.Chooser] = []

    def kept(*given: Any) -> choose.Chooser:
        choosers.append(choose.Chooser(*given))
        return choosers[-1]

    def concluded(context: Any, base: Any, choice: Choice) -> Any:
        first = conclude.conclude(context, base, choice)
        found.update({"in the loop": _answer(first)}, **answers(context, base, choice, choosers[-1]))
        return first

    written: dict[Any, Any] = {}

    def extended_once(context: Any, base: Any, choice: Any) -> Any:
        """Write and fit each structure once: what is changed here only judges it."""
        if choice.structure not in written:
            written[choice.structure] = extend.extend(context, base, choice)
        return written[choice.structure]

    began = time.perf_counter()
    with (
        patch.object(loop, "conclude", concluded),
        patch.object(conclude, "extend", extended_once),
        patch.object(loop, "Chooser", kept),
        chdir(out),
    ):
        run_program(loop_arguments(files, out, options), standalone_mode=False)
    return {"key": case.name, "code": code(), "seconds": round(time.perf_counter() - began, 1), "answers": found}


def table(rows: Sequence[Row]) -> str:
    """Write how many rigs get which verdict under each number, and which answers differ from those as it is."""
    known = cases()
    verdicts: dict[str, Counter[str]] = {}
    differ: dict[str, list[str]] = {}
    for row in rows:
        plain = row["answers"].get("as it is", {}).get("named")
        for name, answer in row["answers"].items():
            verdict = judge_names(answer["named"], answer["equivalent"], known[row["key"]])["verdict"]
            verdicts.setdefault(name, Counter())[verdict] += 1
            if answer["named"] != plain:
                text = " + ".join(f"`{n}`" for n in answer["named"]) or "nothing"
                differ.setdefault(name, []).append(f"{row['key']} {text} ({verdict.replace('_', ' ')})")
    order = ("right", "silent", "place_right", "missed", "false")
    return "\n".join(
        markdown_table(
            ("number", "right", "silent", "place", "missed", "false", "other answers"),
            (
                (name, *(str(counts[v]) for v in order), "; ".join(differ.get(name, ())) or "-")
                for name, counts in verdicts.items()
            ),
        )
    )


def main() -> None:
    known = cases()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recordings", type=Path, action="append", help="folder of recordings (may be repeated)")
    parser.add_argument("--out", type=Path, default=Path("reports"), help="rows and runs: OUT/deciding_numbers")
    parser.add_argument("--only", choices=known, action="append", metavar="NAME", help="rigs")
    parser.add_argument("--workers", type=int, default=2, help="processes of a loop")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--max-minutes", type=float, default=10.0, help="[loop] max_minutes of each loop")
    parser.add_argument("--stop-after", type=float, default=15.0, help="start no loop after so many minutes")
    options = parser.parse_args()
    out = (options.out / "deciding_numbers").resolve()
    play_drive.write(out / "recordings" / "play")
    end, rows = time.monotonic() + 60.0 * options.stop_after, []
    for name in options.only or known:
        files = known[name].find([*(options.recordings or RECORDINGS), out / "recordings"])
        path = out / f"{name}.json"
        if files is not None and not path.exists() and time.monotonic() < end:
            write_summary(run_case(known[name], files, out / "runs" / name, options), path)
        if path.exists():
            rows.append(json.loads(path.read_text(encoding="utf-8")))
    text = table(rows)
    print(text)
    (out / "table.md").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
