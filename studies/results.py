"""Write ``docs/results.md``, and the table of ``README.md``, from the summaries of studies and bench in a folder."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from run import STUDIES
from study.real import change, said
from study.study import markdown, number

ROOT = Path(__file__).resolve().parents[1]
#: Headings of the page, and the studies below each.
SECTIONS = {
    "Real rigs": ("real_rigs",),
    "Terms deleted from real rigs": ("real_trial",),
    "Simulated rigs": ("rig_trial", "fault_trial"),
    "Intervals": ("coverage", "coverage_wrong"),
}
#: Ratios of ``bench.json``, larger is faster but for the last one, and their goals.
SPEED = {
    "engine_over_fmpy_me": ("engine over FMPy, Model Exchange with CVode", "≥ 500"),
    "two_cores_over_one": ("two cores over one", "≥ 1.8"),
    "ess_per_s_over_stretch": ("effective samples a second over emcee's stretch move", ""),
    "ess_per_s_over_fmpy": ("effective samples a second over FMPy with the same sampler", ""),
    "sensitivities_over_plain": ("cost of a run with sensitivities over a plain one", "≤ 5"),
}
#: Rigs that README shows, and the marks between which its table stands.
SHOWN = ("aero_pulse", "battery", "coastdown", "coil", "silverbox", "tank2006", "tclab", "whiffle")
MARKS = ("<!-- results -->\n", "<!-- end of results -->\n")


def read(folder: Path, name: str) -> Mapping[str, Any] | None:
    """Read a summary; None where there is none."""
    path = folder / f"{name}.json"
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    return found or None


def page(folder: Path) -> str:
    """Write the page of results; studies of one section share a table."""
    lines = ["# Results", "", "`make results` writes this page from what the studies and the bench left in `reports/`."]
    for heading, names in SECTIONS.items():
        lines += ["", f"## {heading}"]
        cells: list[tuple[object, ...]] = []
        for name in names:
            study, found = STUDIES[name], read(folder, name)
            command = f"`make {name.replace('_', '-')}`"
            if found is None:
                lines.append(f"{command}: not run. {study.about}")
                continue
            left = f", {found['left']} trials left" if found["left"] else ""
            text, own = study.table(found)
            cells += own
            lines.append(f"{command} ({', '.join(found['code'])}{left}): {study.about} {text}")
        lines += ["", *markdown(STUDIES[names[0]].head, cells)] if cells else []
    return "\n".join([*lines, "", "## Speed", *speed(read(folder, "bench"))]) + "\n"


def speed(found: Mapping[str, Any] | None) -> list[str]:
    """Write the table of speed."""
    if found is None:
        return ["`make bench`: not run."]
    lines = [(words, goal, number(found.get(key))) for key, (words, goal) in SPEED.items()]
    error = f"The largest error of an output is {number(found.get('max_relative_error'))} of its range (goal: ≤ 1e-6)."
    return [f"`make bench`: ratios in one run. {error}", "", *markdown(("", "goal", "measured"), lines)]


def readme(text: str, found: Mapping[str, Any] | None) -> str:
    """Put the table of real rigs between the marks; the text as it is where the study was not run."""
    rows = {row["key"]: row for row in found["rows"]} if found else {}
    if not rows:
        return text
    lines = [(key, said(rows[key]), change(rows[key])) for key in SHOWN if key in rows]
    before, _, rest = text.partition(MARKS[0])
    _, _, after = rest.partition(MARKS[1])
    table = markdown(("rig", "the model lacks", "error on test data"), lines)
    return before + MARKS[0] + "\n".join(table) + "\n" + MARKS[1] + after


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--reports", type=Path, default=ROOT / "reports")
    parser.add_argument("--out", type=Path, default=ROOT, help="folder of README.md and docs (default: the project's)")
    options = parser.parse_args()
    (options.out / "docs" / "results.md").write_text(page(options.reports), encoding="utf-8")
    path = options.out / "README.md"
    path.write_text(readme(path.read_text(encoding="utf-8"), read(options.reports, "real_rigs")), encoding="utf-8")


if __name__ == "__main__":
    main()
