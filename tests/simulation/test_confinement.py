"""Hostile model code costs its own run, whatever it tries, and reaches nothing outside its worker."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import zipfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from runs import ran
from test_engine_isolation import FINE, TIME, trouble
from test_model_load import rewrite, with_member

from aero_bayes.errors import InputError
from aero_bayes.simulation import worker_group, workers
from aero_bayes.simulation.interface import Outcome, Problem
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.native_simulator import NativeSimulator
from aero_bayes.simulation.worker_group import engine_path
from aero_bayes.simulation.workers import WorkerPool

pytestmark = pytest.mark.fast

#: It tells what the kernel offers.
ENGINE = ctypes.CDLL(str(engine_path()))

(PRINT_FOREVER, ALLOCATE, ALLOCATE_SHARED, FORK, EXECUTE, WRITE_OUTSIDE, CHANGE_MODE, FILL_FILE, CONNECT,
 SIGNAL_PARENT, SAY_DONE) = range(14, 25)  # fmt: skip
#: File descriptors below this one are those that the hostile model writes to.
REACH = 32
ENDS = {
    PRINT_FOREVER: {Outcome.TIMED_OUT},
    ALLOCATE: {Outcome.CRASHED},
    SAY_DONE: {Outcome.CRASHED, Outcome.TIMED_OUT},
}
CALLS = (ALLOCATE_SHARED, FORK, EXECUTE, CONNECT, SIGNAL_PARENT)


@pytest.fixture
def problem(test_fmu) -> Problem:
    return trouble(test_fmu, 0.1)


def check(problem: Problem, modes: list[int], pool: WorkerPool) -> None:
    found = ran(problem, pool, np.array(modes, dtype=float)[:, None])
    for mode, outcome, out in zip(modes, found.outcomes[:, 0], found.outputs[0], strict=True):
        if mode in ENDS:
            assert Outcome(outcome) in ENDS[mode], mode
        else:
            assert outcome == Outcome.OK, mode
            np.testing.assert_allclose(out[:, 0], np.exp(-TIME), atol=1e-5, err_msg=f"mode {mode} got through")


def test_what_costs_its_own_run(problem):
    # A slow machine takes more than its usual time to hand out the memory.
    patient = replace(problem, settings=replace(problem.settings, time_limit=20.0))
    with WorkerPool(1, memory_limit=64 << 20) as pool:
        check(problem, [m for mode in (PRINT_FOREVER, SAY_DONE, FILL_FILE) for m in (mode, FINE)] * 2, pool)
        check(patient, [ALLOCATE, FINE] * 2, pool)


@pytest.mark.skipif(not ENGINE.ab_seccomp(), reason="the kernel has no seccomp")
def test_calls_that_are_refused(problem, pool):
    check(problem, [m for mode in CALLS for m in (mode, FINE)], pool)


@pytest.mark.skipif(ENGINE.ab_landlock() < 3, reason="the kernel has no Landlock of version 3")
def test_files_outside_its_folder(problem, pool):
    check(problem, [WRITE_OUTSIDE, FINE, CHANGE_MODE, FINE], pool)
    assert not Path("/dev/shm/aero-bayes-evil").exists()
    resource = pool.binary(problem.model).parents[2] / "resources" / "y.txt"
    assert resource.read_text() == "42.5"


def test_what_is_refused_here_works_unconfined(problem, monkeypatch):
    # or the tests above would prove nothing
    monkeypatch.setenv(worker_group.TRUST, "1")
    with WorkerPool(1) as pool, NativeSimulator(problem, pool=pool) as simulator:
        found = simulator.simulate(np.array([*CALLS, WRITE_OUTSIDE, CHANGE_MODE, FILL_FILE], dtype=float)[:, None])
    assert np.all(found.outcomes == Outcome.OK)
    assert np.all(found.outputs[0][:, 0, 0] == 100.0)


def spoil_slots(problem: Problem) -> None:
    """The shared memory within the model's reach, the pipes of its worker out of it: only the clock can tell."""
    workers.MAX_SILENCE = 1e6
    with WorkerPool(1) as pool:
        assert pool.group.fd < REACH
        taken = [os.open(os.devnull, os.O_RDONLY) for _ in range(40)]
        assert min(taken[-2:]) >= REACH
        check(problem, [SAY_DONE, FINE, SAY_DONE, FINE], pool)


def test_a_worker_that_spoils_its_slot_and_says_nothing_is_ended_in_time(problem):
    # in a process of its own, however many files are open in this one
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as fresh:
        fresh.submit(spoil_slots, problem).result(timeout=120)


def test_a_workers_folder_goes_with_it(problem):
    with WorkerPool(1) as pool, NativeSimulator(problem, pool=pool) as simulator:
        simulator.simulate(np.array([[FILL_FILE], [FINE], [SAY_DONE], [FINE]], dtype=float))
        assert len(list(pool.folder.glob("worker-*"))) == 1


def packed(path: Path, *members: tuple[zipfile.ZipInfo | str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in members:
            archive.writestr(name, data)
    return path


def of_kind(name: str, kind: int) -> zipfile.ZipInfo:
    info = zipfile.ZipInfo(name)
    info.create_system = 3
    info.external_attr = (kind | 0o644) << 16
    return info


@pytest.mark.parametrize(
    ("members", "message"),
    [
        ([(of_kind("resources/link", 0o120000), b"/etc")], "symbolic link"),
        ([(of_kind("resources/pipe", 0o010000), b"")], "neither a file nor a folder"),
        ([("resources", b"x"), ("resources/y.txt", b"y")], "file and a folder"),
        ([("resources/y.txt", b"x"), ("resources\\y.txt", b"y")], "there twice"),
        ([("/modelDescription.xml", b"x")], "outside"),
        ([("C:/evil", b"x")], "outside"),
        ([(f"resources/{i}", b"") for i in range(60)], "members"),
        ([("resources/a\\..\\..\\..\\b", b"x")], "outside"),
    ],
)
def test_archives_that_are_not_unpacked(tmp_path, monkeypatch, members, message):
    monkeypatch.setattr("aero_bayes.simulation.archive.MAX_MEMBERS", 50)
    path = packed(tmp_path / "bad.fmu", ("modelDescription.xml", b"<fmiModelDescription/>"), *members)
    with pytest.raises(InputError, match=message):
        Model.load(path)


def test_an_archive_that_lies_about_a_size(test_fmu, tmp_path):
    # the directory says one byte where the packed data hold a mebibyte: no more than said is ever written
    big = with_member("resources/big", bytes(1 << 20))
    path = rewrite(test_fmu("Dahlquist").path, tmp_path / "liar.fmu", big)
    data = path.read_bytes()
    honest = (1 << 20).to_bytes(4, "little")
    assert data.count(honest) == 2
    path.write_bytes(data.replace(honest, (1).to_bytes(4, "little")))
    folder = tmp_path / "unpacked"
    folder.mkdir()
    with pytest.raises(InputError, match="zip"):
        Model.load(path).unpack(folder)
    assert sum(f.stat().st_size for f in folder.rglob("big")) <= 1
    assert os.listdir(tmp_path)
