"""The page of what numbers are held against counts the tests that ran, and shows the worst of what they noted."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

CASE = '<testcase classname="tests.known_answers.test_nist_strd" name="n">{}</testcase>'
NOTED = '<properties><property name="trust:nist" value="{}"/></properties>'


def test_the_worst_case_and_failures_are_shown(tmp_path: Path) -> None:
    cases = [CASE.format(NOTED.format(digits)) for digits in (11.0, 6.4, 9.2)]
    cases += [CASE.replace("known_answers.test_nist_strd", "laws.test_laws").format(end) for end in ("", "<failure/>")]
    cases += [CASE.replace("known_answers.test_nist_strd", "laws.test_attached_is_written").format("<skipped/>")]
    found = tmp_path / "tests.xml"
    found.write_text(f"<testsuites><testsuite>{''.join(cases)}</testsuite></testsuites>", encoding="utf-8")
    script = Path(__file__).parents[2] / "docs" / "trust.py"
    subprocess.run([sys.executable, str(script), str(tmp_path / "trust.md"), str(found)], check=True, timeout=60)
    rows = [line.split(" | ") for line in (tmp_path / "trust.md").read_text(encoding="utf-8").splitlines()]
    told = {row[0].removeprefix("| "): row[2:4] for row in rows if len(row) == 5}
    assert told["local search, both starts"] == ["3", "6.4 digits"]
    assert told["laws of the library"] == ["2", "**1 failed**"]
    assert told["every law at every port, attached"] == ["0", "not run"]
