"""The speed report's parts that compute rather than time: goals, absent packages, the picture, PINTS' likelihood."""

from __future__ import annotations

import json
import subprocess
import sys
from xml.etree import ElementTree

import bench
import bench_density
import bench_growth
import bench_pints
import bench_plot
import bench_sampling
import numpy as np
import pytest
from harness import Goal, Route, TimingRow, missing, ratio, time_routes, update

from aero_bayes.estimate import Target
from aero_bayes.simulation import open_simulator

pytestmark = pytest.mark.long


def test_goals_are_met_on_the_right_side():
    low, high = Goal("a", "a", 2.0), Goal("b", "b", 2.0, at_most=True)
    assert low.line({"a": 2.1}).endswith(" met")
    assert low.line({"a": 1.9}).endswith("NOT MET")
    assert high.line({"b": 1.9}).endswith(" met")
    assert high.line({"b": 2.1}).endswith("NOT MET")
    assert high.line({"b": None}).endswith("not measured")
    assert high.line({}).endswith("not measured")


def test_what_is_not_installed_is_a_line_and_not_a_failure(monkeypatch):
    monkeypatch.setattr(bench_pints, "installed", lambda: False)
    rows = bench_pints.chain_rows(None, None)  # type: ignore[arg-type]
    assert [row.name for row in rows] == [bench_pints.SAMPLER, bench_pints.SAMPLER_SLOW]
    assert all("not installed" in row.line() and row.seconds is None for row in rows)
    assert ratio(rows[0].seconds, 1.0) is None


def test_rows_of_a_group_replace_earlier_ones(tmp_path):
    path = tmp_path / "bench.json"
    update(path, {"x": 1.0}, [TimingRow("a", "old", 1.0, 1.0, 1.0), TimingRow("b", "kept", 1.0, 1.0, 1.0)], ("a", "b"))
    update(path, {"y": None}, [missing("a", "new", "PINTS")], ("a",))
    report = json.loads(path.read_text())
    assert (report["x"], report["y"]) == (1.0, None)
    assert {row["name"] for row in report["rows"]} == {"kept", "new"}


def test_each_route_is_called_once_a_round_and_once_before():
    calls: list[str] = []
    rows = time_routes([Route("g", name, lambda name=name: calls.append(name)) for name in "ab"], 3)
    assert calls == list("ab") * 4
    assert all(row.low <= row.seconds <= row.high for row in rows.values())


def test_picture_and_goals_from_a_report_with_gaps(tmp_path, capsys):
    rows = [
        TimingRow("one run", "FMPy, Model Exchange, CVode", 0.06, 0.06, 0.06),
        TimingRow("one run", "engine, batch of 100, one core", 2e-4, 2e-4, 2e-4),
        TimingRow("sampling", "mix of moves, engine", 1e-3, 1e-3, 1e-3),
        missing("pints", bench_pints.SAMPLER_SLOW, "PINTS"),
        *(TimingRow("growth", f"{n:,} samples", 1e-7 * n, 0.0, 1.0) for n in (2001, 20001)),
        *(TimingRow("states", f"{n} states", 1e-5 * n, 0.0, 1.0) for n in (4, 16)),
    ]
    report = tmp_path / "bench.json"
    update(report, {"engine_over_fmpy_me": 300.0}, rows, ())
    bench.print_goals(report)
    shown = capsys.readouterr().out
    assert all(goal.text in shown for goal in bench.GOALS)
    bench_plot.draw_bench(report, tmp_path / "bench.svg")
    assert ElementTree.parse(tmp_path / "bench.svg").getroot().tag.endswith("svg")
    assert not [p for p in tmp_path.iterdir() if p.name.startswith(".")]


def test_the_ladder_is_a_chain_of_low_passes(tmp_path):
    problem = bench_growth.ladder_problem(4, tmp_path)
    matrix = 10.0 * (np.diag([-2.0, -2.0, -2.0, -1.0]) + np.diag(np.ones(3), 1) + np.diag(np.ones(3), -1))
    t = problem.experiments[0].time[:1001]
    rates, vectors = np.linalg.eigh(matrix)
    gain = np.linalg.solve(vectors, -np.linalg.solve(matrix, np.array([240.0, 0.0, 0.0, 0.0])))
    expected = 2.0 * (vectors[3] * gain) @ (1.0 - np.exp(np.outer(rates, t)))
    with open_simulator(problem, workers=0) as simulator:
        found = simulator.simulate(np.array([[1.0, 0.1]])).outputs[0][0, :1001, 0]
    np.testing.assert_allclose(found, expected, atol=48e-5)


def test_memory_that_a_process_takes_is_seen():
    """A process that fills 48 MiB between two readings of its peak."""
    script = "input(); held = b'x' * (48 << 20); print(len(held), flush=True); input()"
    with subprocess.Popen([sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        before = bench_growth.peak_mib(process.pid)
        process.stdin.write(b"\n")
        process.stdin.flush()
        assert int(process.stdout.readline()) == 48 << 20
        grown = bench_growth.peak_mib(process.pid) - before
        process.communicate(b"\n")
    assert 47.0 < grown < 64.0


def test_twice_as_many_runs_take_no_more_memory(tmp_path):
    assert bench_growth.memory(tmp_path, 20, 40) < 1.0


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    return bench_sampling.paper_fit(tmp_path_factory.mktemp("bench"))


def test_pints_on_fmpy_sees_the_same_posterior(found, tmp_path):
    pytest.importorskip("pints")
    d = len(found.free)
    rng = np.random.default_rng(0)
    points = found.laplace.mean[:d] + found.laplace.sd[:d] * rng.standard_normal((3, d))
    with open_simulator(found.calibration.problem(), workers=0) as simulator:
        target = Target(found.calibration, simulator, found.values, found.free)
        ours = bench_density.density(found, target)(points)
        theirs = [bench_pints.fmpy_posterior(found, target, tmp_path)(point) for point in points]
    assert np.ptp(ours) > 1.0
    np.testing.assert_allclose(np.diff(ours), np.diff(theirs), atol=1.0)  # FMPy's own error at this tolerance


def test_swarm_rows_with_and_without_pints(found):
    ours, absent = bench_pints.swarm_rows(found, None, iterations=2)
    assert ours.seconds is not None
    assert absent.seconds is None
    pytest.importorskip("pints")
    _, theirs = bench_pints.swarm_rows(found, 0.06, iterations=2)
    assert theirs.seconds == 0.06
