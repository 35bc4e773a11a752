"""Whatever loggers write above and below a table, in any dialect: its names and numbers are found."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from aero_bayes.data import Layout, read_recording

pytestmark = pytest.mark.fast

LAYOUT = Layout.of(["u"], ["y", "z"], {"u": "V", "y": "m", "z": "K"})
ABOVE = [
    "Device;X-200", "Serial,12345", "Operator: Müller", "Date: 01.03.2026", "Sample rate,10,Hz", "Channels;3", "",
    "Range : min = 0,00 V, max = 5,00 V", "Note", "# comment, with commas", "Title of the run", "Start\t12:00:00",
    "Offset,0.5", "Gain;1,5;2,5", "Version 1.2.3", "a,b,c,d",
]  # fmt: skip


@pytest.mark.parametrize("seed", range(30))
def test_a_table_in_any_surroundings(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    rows, separator = int(rng.choice([8, 30, 300])), str(rng.choice([",", ";", "\t", " "]))
    comma = separator in ";\t" and rng.random() < 0.5
    values = np.column_stack([0.5 * np.arange(rows), rng.choice([0.0, 1.5, -2.25], rows), rng.normal(size=(rows, 2))])
    gaps = (np.arange(rows) > 3) & (rng.random(rows) < 0.1) & (separator != " ")
    names = ["time", "u", "y", "z", *(["status"] if rng.random() < 0.3 else [])]
    units = rng.random() < 0.5
    head = [separator.join(names), *([separator.join(["s", "V", "m", "K", "-"][: len(names)])] if units else [])]
    head += [separator.join(["float"] * len(names))] if units and rng.random() < 0.5 else []
    body = []
    for row, gap in zip(values, gaps, strict=True):
        cells = [f"{x:.9f}".replace(".", "," if comma else ".") for x in row]
        cells[2] = str(rng.choice(["", "NaN", "#NV"])) if gap else cells[2]
        body.append(separator.join([*cells, "ok"][: len(names)]))
    above = list(rng.choice(ABOVE, rng.choice([0, 1, 3, 12, 40])))
    below = ["End of file", separator.join(["Mean", *["1.0"] * (len(names) - 1)]), "", "Rows: 5"]
    text = "\n".join([*above, *head, *body, *rng.choice(below, rng.choice([0, 1, 3]))])
    (tmp_path / "run.csv").write_bytes(text.encode(str(rng.choice(["utf-8", "cp1252", "utf-16"]))))
    found = read_recording(tmp_path / "run.csv", layout=LAYOUT)
    assert found.time == pytest.approx(values[:, 0])
    assert found.inputs["u"] == pytest.approx(values[:, 1])
    assert found.outputs["y"] == pytest.approx(np.where(gaps, np.nan, values[:, 2]), abs=1e-8, nan_ok=True)
    assert found.outputs["z"] == pytest.approx(values[:, 3], abs=1e-8)


def test_what_was_skipped_is_told_by_its_rows(tmp_path: Path) -> None:
    rows = "".join(f"{k};{k};1,5\n" for k in range(10))
    (tmp_path / "run.csv").write_text(
        "Logger 3\nRange;5\n\ntime;u;y\ns;V;m\ndouble;float;float\n" + rows + "Total;1;2\nEnd\n"
    )
    (note,) = read_recording(tmp_path / "run.csv", layout=LAYOUT).notes
    assert "row 4" in note
    assert "rows 1 to 2, 6, 17 to 18" in note
    (tmp_path / "run.csv").write_text("# Logger 3\ntime;u;y\n" + rows)
    assert read_recording(tmp_path / "run.csv", layout=LAYOUT).notes == ()
