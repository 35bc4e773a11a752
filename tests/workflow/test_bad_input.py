"""Every mistake a user can make on the command line: one clear line, exit status 2, nothing half-written."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from aero_bayes.cli import main
from aero_bayes.modelica.compilers import export_fmu

pytestmark = pytest.mark.fast

HEADER = "time,V_m,i_m,omega_m,theta"
RATE_HZ = 50.0


def rows(duration: float = 10.0) -> list[str]:
    """A quiet, plausible recording."""
    times = np.arange(0.0, duration, 1.0 / RATE_HZ)
    swing = 0.1 * np.sin(1.3 * times)
    driven = times > 1.0
    return [f"{t:.3f},{12.0 * on:g},0.1,{200.0 * on:g},{y:.5f}" for t, on, y in zip(times, driven, swing, strict=True)]


def scaled(line: str, column: int, factor: float) -> str:
    cells = line.split(",")
    cells[column] = f"{float(cells[column]) * factor:g}"
    return ",".join(cells)


def replaced(lines: list[str], row: int, column: int, text: str) -> list[str]:
    cells = lines[row].split(",")
    cells[column] = text
    return [*lines[:row], ",".join(cells), *lines[row + 1 :]]


MISTAKES: dict[str, tuple[Callable[[], str], tuple[str, ...]]] = {
    "missing column": (lambda: "\n".join(["time,i_m,theta", "0,0,0", "0.02,0,0"]), ("V_m",)),
    "text in a number": (lambda: "\n".join([HEADER, *replaced(rows(), 9, 4, "abc")]), ("row 11", "theta", "abc")),
    "time backwards": (lambda: "\n".join([HEADER, *replaced(rows(), 9, 0, "0.001")]), ("row 11", "time")),
    "empty file": (lambda: "", ("empty",)),
    "header only": (lambda: HEADER + "\n", ("no",)),
    "gap in the input": (lambda: "\n".join([HEADER, *replaced(rows(), 9, 1, "")]), ("row 11", "V_m")),
    "NaN block": (
        lambda: "\n".join([HEADER, *[replaced([line], 0, 4, "nan")[0] for line in rows()]]),
        ("theta", "0 readings"),
    ),
    "time in ms": (lambda: "\n".join([HEADER, *[scaled(line, 0, 1000.0) for line in rows()]]), ("time", "s")),
    "pitch in mrad": (lambda: "\n".join([HEADER, *[scaled(line, 4, 1000.0) for line in rows()]]), ("theta", "rad")),
    "voltage in mV": (lambda: "\n".join([HEADER, *[scaled(line, 1, 1000.0) for line in rows()]]), ("V_m", "V")),
    "current in mA": (lambda: "\n".join([HEADER, *[scaled(line, 2, 1000.0) for line in rows()]]), ("i_m", "A")),
}


def run(tmp_path: Path, *arguments: str) -> tuple[Result, Path]:
    out = tmp_path / "out"
    return CliRunner().invoke(main, [*arguments, "--out", str(out), "--quiet"]), out


def assert_refused(result: Result, out: Path, words: tuple[str, ...]) -> None:
    assert result.exit_code == 2, result.output
    lines = result.stderr.strip().splitlines()
    assert len(lines) == 1, result.stderr
    assert lines[0].startswith("error: ")
    for word in words:
        assert word in lines[0]
    written = [path.name for path in out.rglob("*") if path.is_file() and path.suffix != ".fmu"] if out.exists() else []
    assert written == []


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_fmu("Aero.Systems.OneDof", tmp_path_factory.mktemp("fmu") / "OneDof.fmu")


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "good.csv"
    path.write_text("\n".join([HEADER, *rows()]) + "\n")
    return path


@pytest.mark.parametrize("mistake", MISTAKES)
def test_bad_recording(mistake: str, tmp_path: Path, fmu: Path) -> None:
    text, words = MISTAKES[mistake]
    data = tmp_path / "data.csv"
    data.write_text(text())
    result, out = run(tmp_path, "fit", "--data", str(data), "--model", str(fmu))
    assert_refused(result, out, ("data", *words))


def test_no_such_recording(tmp_path: Path, fmu: Path) -> None:
    result, out = run(tmp_path, "fit", "--data", str(tmp_path / "none.csv"), "--model", str(fmu))
    assert_refused(result, out, ("none.csv",))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[parameters.R_a]\nlower = 9.0\nvalue = 8.4\n", ("R_a", "8.4", "bounds")),
        ("[parameters.R_a]\nlowr = 9.0\n", ("parameters.R_a.lowr", "lower")),
        ("[fitt]\n", ("fitt", "fit")),
        ("[fit.pso]\nparticles = -1\n", ("fit.pso.particles", "-1")),
        ("[parameters.R_b]\nfree = true\n", ("R_b", "R_a")),
        ('[parameters.R_a.prior]\nkind = "normal"\nmean = 8.4\n', ("R_a", "sd")),
        ("[fit\n", ("TOML",)),
    ],
)
def test_bad_configuration(text: str, words: tuple[str, ...], tmp_path: Path, fmu: Path, recording: Path) -> None:
    config = tmp_path / "study.toml"
    config.write_text(text)
    result, out = run(tmp_path, "fit", "--data", str(recording), "--model", str(fmu), "--config", str(config))
    assert_refused(result, out, words)


def test_recordings_of_one_name(tmp_path: Path, fmu: Path, recording: Path) -> None:
    result, out = run(tmp_path, "fit", "--data", str(recording), "--data", str(recording), "--model", str(fmu))
    assert_refused(result, out, (recording.name, "given twice"))
    namesake = tmp_path / "other" / recording.name
    namesake.parent.mkdir()
    namesake.write_bytes(recording.read_bytes())
    result, out = run(tmp_path, "fit", "--data", str(recording), "--data", str(namesake), "--model", str(fmu))
    assert_refused(result, out, (str(namesake), str(recording), "different names"))


def test_corrupted_fmu(tmp_path: Path, fmu: Path, recording: Path) -> None:
    broken = tmp_path / "broken.fmu"
    broken.write_bytes(fmu.read_bytes()[: fmu.stat().st_size // 2])
    result, out = run(tmp_path, "fit", "--data", str(recording), "--model", str(broken))
    assert_refused(result, out, ("broken.fmu",))


def test_fmu_whose_binary_is_no_library(tmp_path: Path, fmu: Path, recording: Path) -> None:
    broken = tmp_path / "broken.fmu"
    with zipfile.ZipFile(fmu) as source, zipfile.ZipFile(broken, "w") as target:
        for item in source.infolist():
            binary = item.filename.endswith(".so")
            target.writestr(item, b"not a library" if binary else source.read(item.filename))
    result, out = run(tmp_path, "fit", "--data", str(recording), "--model", str(broken))
    assert_refused(result, out, ("broken",))


def test_unknown_modelica_class(tmp_path: Path, recording: Path) -> None:
    result, out = run(tmp_path, "fit", "--data", str(recording), "--model", "Aero.Systems.ThreeDof")
    assert_refused(result, out, ("ThreeDof",))


def test_unknown_option_is_bad_input(tmp_path: Path) -> None:
    assert CliRunner().invoke(main, ["fit", "--dta", "x.csv"]).exit_code == 2


def test_a_refused_run_says_whose_result_is_in_its_folder(recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "result.json").write_text("{}")
    bad = tmp_path / "bad.csv"
    bad.write_text(recording.read_text("utf-8").replace("V_m", "volts", 1))
    for out_there, said in ((out, True), (tmp_path / "new", False)):
        result = CliRunner().invoke(
            main, ["fit", "--data", str(bad), "--model", "Aero.Systems.OneDof", "--out", str(out_there)]
        )
        assert (result.exit_code, len(result.stderr.splitlines())) == (2, 1)
        assert (str(out_there / "result.json") in result.stderr) == said


def test_bounds_in_the_wrong_order_name_the_modelica_file(tmp_path: Path) -> None:
    source = tmp_path / "Rig.mo"
    source.write_text("model Rig\n  parameter Real k(min = 30, max = 10) = 20;\n  output Real x(start = 1);\n"
                      "equation\n  der(x) = -k * x;\nend Rig;\n")  # fmt: skip
    result = CliRunner().invoke(main, ["fmu", "--model", "Rig", "--source", str(source), "--out", f"{tmp_path}/x.fmu"])
    assert result.exit_code == 2
    assert result.stderr.startswith("error: Rig.mo:2: ")
    assert "k: min = 30" in result.stderr


def test_report_of_an_empty_folder(tmp_path: Path) -> None:
    result = CliRunner().invoke(main, ["report", str(tmp_path)])
    assert result.exit_code == 2
    assert "result.json" in result.stderr


def test_the_installed_command_ends_with_status_2(tmp_path: Path) -> None:
    command = [Path(sys.executable).with_name("aero-bayes"), "check", str(tmp_path / "none.csv")]
    finished = subprocess.run(command, capture_output=True, text=True)
    assert finished.returncode == 2
    assert finished.stderr.count("\n") == 1
