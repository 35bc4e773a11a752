"""``docs/trust.md`` from what the tests noted and counted: ``trust.py docs/trust.md reports/tests.xml ...``."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

HEAD = """# Why these numbers can be trusted

`make trust` writes this page from what the tests noted and counted (`make test-all`). A row says what was compared
with what, in how many cases, how far off the worst one was, and in which test. How often the program is right on rigs,
and how often its intervals hold the truth, stands in [Results](results.md).
"""


@dataclass(frozen=True)
class Row:
    """What is compared with what; tests note their differences under ``key``, or pass or fail in ``place``."""

    what: str
    against: str
    place: str
    key: str = ""
    unit: str = "of the range"


ROWS = {
    "Numbers": (
        Row("local search, both starts", "NIST StRD, 11 digits", "known_answers/nist_strd", "nist", "digits"),
        Row("engine, parameters moving", "closed forms", "simulation/engine_closed_forms", "closed-form"),
        Row("engine, inputs moving at each sample", "SciPy at 1e-10", "simulation/moving_inputs", "scipy"),
        Row("engine, events", "closed forms", "simulation/engine_events", "events"),
        Row("engine, events and loops", "CVode through FMPy", "simulation/engine_agrees", "cvode"),
        Row("laws of the library", "closed forms by hand", "laws/laws"),
        Row("laws attached to a model, over time", "the same laws, written", "laws/attach", "attached"),
        Row("every law at every port, attached", "the same laws, written", "laws/attached_is_written"),
        Row("FMUs that do as other tools' do", "SciPy, closed forms", "simulation/other_tools"),
        Row("FMUs from the standard library", "closed forms and recorded runs", "export/standard_library"),
    ),
    "Uncertainty": (
        Row("Laplace's approximation", "closed form, linear model", "known_answers/linear_gaussian", "laplace", "sd"),
        Row("sampler, sd", "closed form, linear model", "known_answers/linear_gaussian", "sampler", "sd"),
        Row("sampler, means (hare and lynx)", "Stan, as published", "known_answers/hare_lynx", "stan", "sd"),
        Row("share of intervals that hold, as counted", "ranks of known distributions", "studies/coverage"),
    ),
    "Faults survived": (
        Row("workers that crash, hang or are killed", "the other runs' numbers", "simulation/engine_isolation"),
        Row("FMUs that write, connect, start programs", "refused by the kernel", "simulation/confinement"),
        Row("full disk, folders that cannot be made", "one line, nothing half-written", "workflow/system_errors"),
        Row("interrupted and resumed runs", "the run that was not", "estimate/resumed_fit"),
        Row("damaged and odd data files", "the same table, or one line", "data/odd_files"),
        Row("another processor, readings off by 1e-9", "the same answer of the loop", "loop/other_processors"),
    ),
}  # fmt: skip


def cases(paths: Sequence[Path]) -> Iterator[tuple[str, bool, dict[str, list[float]]]]:
    """Yield of each test that was not skipped its file, whether it passed, and what it noted."""
    for path in paths:
        for case in ElementTree.parse(path).iter("testcase"):
            if case.find("skipped") is not None:
                continue
            noted: dict[str, list[float]] = {}
            for item in case.iter("property"):
                noted.setdefault(item.get("name", ""), []).append(float(item.get("value", "nan")))
            failed = case.find("failure") is not None or case.find("error") is not None
            room, _, name = case.get("classname", "").removeprefix("tests.").rpartition(".")
            yield f"{room}/{name.removeprefix('test_')}", not failed, noted


def page(paths: Sequence[Path]) -> str:
    """Return the page."""
    found, lines = list(cases(paths)), [HEAD]
    for title, rows in ROWS.items():
        lines += [f"## {title}", "| what | against | cases | worst case | test |", "| --- | --- | --- | --- | --- |"]
        for row in rows:
            lines.append(f"| {row.what} | {row.against} | {_told(row, found)} | `{row.place.replace('/', '/test_')}` |")
        lines.append("")
    return "\n".join(lines)


def _told(row: Row, found: Sequence[tuple[str, bool, dict[str, list[float]]]]) -> str:
    """Number of cases, and the worst one."""
    own = [(passed, noted) for place, passed, noted in found if place == row.place]
    failed = sum(not passed for passed, _ in own)
    end = f"**{failed} failed**" if failed else "all hold" if own else "not run"
    if not row.key:
        return f"{len(own)} | {end}"
    values = [value for _, noted in own for value in noted.get(f"trust:{row.key}", ())]
    if not values:
        return "0 | not run"
    worst = f"{min(values):.1f}" if row.unit == "digits" else f"{max(values):.1e}"
    return f"{len(values)} | {worst} {row.unit}{f'; {end}' if failed else ''}"


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(page([Path(path) for path in sys.argv[2:]]), encoding="utf-8")
