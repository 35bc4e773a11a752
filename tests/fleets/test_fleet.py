"""A fleet from its file to its page: rigs of its own, one that cannot be read, the same table in any order."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from aero_bayes.cli import main
from aero_bayes.commands.fleet import FleetPlan, Rig, attempt, fleet, read_fleet, tasks_of
from aero_bayes.commands.fleet_runner import read_rows
from aero_bayes.commands.fleet_summary import digest
from aero_bayes.errors import InputError
from aero_bayes.report.schema_run import FleetJson
from simulate_fleet import write_fleet

#: Fits from where they start; nothing that only a page of a single rig wants.
QUICK = '[prediction]\nmax_seconds = 0\n\n[fit.local]\nstarts = 1\n\n[fit]\nmethod = "local"\n'


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four simulated carts, one of them with a wrong mass; and one rig without a file."""
    root = tmp_path_factory.mktemp("carts")
    path = write_fleet(root, "cart", 4, share=0.0, work="fit")
    path.write_text(path.read_text("utf-8").replace("[fit]\n", QUICK), "utf-8")
    table = root / "rigs.csv"
    lines = table.read_text("utf-8").splitlines()
    lines = [lines[0] + ',parameters."mass.m".value', *(f"{line}," for line in lines[1:])]
    lines[4] += "2.0"
    table.write_text("\n".join([*lines, "lost,recordings/lost/train.csv,,"]) + "\n", "utf-8")
    return root


@pytest.fixture(scope="module")
def done(folder: Path) -> tuple[Path, FleetJson]:
    return folder / "out", fleet(folder / "fleet.toml", folder / "out", seed=3)


@pytest.mark.long
def test_every_rig_is_a_row_and_has_its_page(folder: Path, done: tuple[Path, FleetJson]) -> None:
    out, found = done
    truth = {r["name"]: r["parameters"] for r in json.loads((folder / "truth.json").read_text("utf-8"))["rigs"]}
    rows = read_rows(out / "rigs.jsonl")
    assert digest([row for _, row in sorted(rows.items())]) == found.table_sha256
    assert "no such file" in rows["lost"]["error"]
    assert (found.rigs, found.failed) == (5, 1)
    for name in ("cart-1", "cart-2", "cart-3"):
        entry = rows[name]["parameters"]["spring.k"]
        assert entry["centre"] == pytest.approx(np.log(truth[name]["spring.k"]), abs=6 * entry["width"])
        assert set(rows[name]["parameters"]) == {"spring.k", "damper.d"}
    held = json.loads((out / "rigs" / "cart-4" / "result.json").read_text("utf-8"))["parameters"]["mass.m"]
    assert (held["value"], held["status"]) == (2.0, "fixed")
    # A mass that is said to be larger than it is leaves structure in the residual.
    assert [entry.rig for entry in found.stand_out] == ["cart-4"]
    assert "times the noise floor" in found.stand_out[0].reasons[0]
    assert found.simulated
    FleetJson.model_validate_json((out / "fleet.json").read_text("utf-8"), extra="forbid")  # every key is declared
    page = (out / "report.html").read_text("utf-8")
    assert "Simulated data" in page
    for link in re.findall(r'href="(rigs/[^"]+)"', page):
        assert (out / link).is_file()


def test_a_rig_gives_the_same_row_alone_and_again(folder: Path, done: tuple[Path, FleetJson], tmp_path: Path) -> None:
    out, _ = done
    *_, task = (t for t in tasks_of(read_fleet(folder / "fleet.toml"), tmp_path, 3) if t.rig.name == "cart-2")
    assert digest([attempt(task)]) == digest([read_rows(out / "rigs.jsonl")["cart-2"]])
    task.model.write_bytes(b"another model")
    assert f"{task.model}: has changed" in attempt(task)["error"]
    before = {path: path.stat().st_mtime_ns for path in out.glob("rigs/*/result.json")}
    fleet(folder / "fleet.toml", out, seed=3)
    assert {path: path.stat().st_mtime_ns for path in out.glob("rigs/*/result.json")} == before
    fleet(folder / "fleet.toml", out, seed=4)
    assert len(before) == sum(path.stat().st_mtime_ns > then for path, then in before.items())  # another seed


def test_seeds_belong_to_the_rig() -> None:
    rigs = [Rig(name, ()) for name in ("a", "b")]
    assert [rig.seed(1) for rig in rigs] == [rig.seed(1) for rig in reversed(rigs)][::-1]
    assert len({rig.seed(seed) for rig in rigs for seed in (1, 2)}) == 4


@pytest.mark.parametrize(
    ("text", "rigs", "says"),
    [
        ("[fleet]\nwork = 'dance'\n", None, "fleet.work"),
        ("[fleet]\n", None, "no rigs"),
        ("[fleet]\nrigs = 'rigs.csv'\n", "name;train\n", "no column name"),
        ("[fleet]\nrigs = 'rigs.csv'\n", "name,train\n../up,a.csv\n", "row 2"),
        ("[fleet]\nrigs = 'rigs.csv'\n", None, "cannot be read"),
        ("[fit]\nmethods = 'local'\n[[rig]]\nname = 'a'\ntrain = ['a.csv']\n", None, "did you mean 'method'"),
        ("[[rig]]\nname = 'a'\ntrain = ['a.csv']\ntests = ['b.csv']\n", None, "did you mean 'test'"),
    ],
)
def test_a_file_that_is_wrong_is_one_line(tmp_path: Path, text: str, rigs: str | None, says: str) -> None:
    (tmp_path / "fleet.toml").write_text(text, "utf-8")
    if rigs is not None:
        (tmp_path / "rigs.csv").write_text(rigs, "utf-8")
    answer = CliRunner().invoke(
        main, ["fleet", "--config", str(tmp_path / "fleet.toml"), "--out", str(tmp_path / "out"), "--quiet"]
    )
    assert answer.exit_code == 2
    assert says in answer.output
    assert len(answer.output.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_a_cell_is_read_as_toml_and_a_word_needs_no_quotes(tmp_path: Path) -> None:
    (tmp_path / "fleet.toml").write_text("[fleet]\nrigs = 'rigs.csv'\n", "utf-8")
    (tmp_path / "rigs.csv").write_text('name,train,fit.method,parameters."k.c".value\na,a.csv,local,2.5\n', "utf-8")
    (rig,) = read_fleet(tmp_path / "fleet.toml").rigs
    assert rig.settings == {"fit": {"method": "local"}, "parameters": {"k.c": {"value": 2.5}}}


def test_two_rigs_of_one_name_are_refused(tmp_path: Path) -> None:
    rigs = [Rig("a", (Path("a.csv"),)), Rig("a", (Path("b.csv"),))]
    plan = FleetPlan({"model": {"name": "Aero.Systems.OneDof"}}, tmp_path, "fit", rigs)
    with pytest.raises(InputError, match="two rigs are called a"):
        list(tasks_of(plan, tmp_path, 1))
