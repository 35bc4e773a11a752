"""Nothing is lost: dead workers, killed callers, restarts and failures all end in the same table."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time
from importlib import import_module
from pathlib import Path

import pytest
from facts import facts
from fleets.fleet_tasks import one_always_dies, plain, rows_of, work

from aero_bayes.commands.fleet_runner import open_client, read_rows
from aero_bayes.commands.fleet_summary import digest
from aero_bayes.errors import InputError

pytestmark = pytest.mark.long


@pytest.mark.parametrize("dask", [None, "local"])
def test_workers_that_die_change_nothing(tmp_path: Path, dask: str | None) -> None:
    if dask:
        pytest.importorskip("distributed")
    with open_client(dask, 2) as client:
        found = rows_of(tmp_path, work, 8, client=client, workers=2)
    assert digest(found) == digest(rows_of(tmp_path / "expected", plain, 8, workers=1))
    assert found[6]["error"] == "ValueError: this one cannot be"


def test_a_task_that_kills_every_worker_is_a_row_that_says_so(tmp_path: Path) -> None:
    rows = rows_of(tmp_path, one_always_dies, 4, 0.3, workers=2)
    assert re.search(facts("worker", "3"), rows[1]["error"])
    assert [row["key"] for row in rows if "error" in row] == ["0001"]


def caller(task: str, folder: Path) -> subprocess.Popen[bytes]:
    """A process of its own, in a session of its own: what Ctrl-C sends reaches it alone."""
    code = (
        f"import sys, signal; sys.path.insert(0, {str(Path(__file__).parents[1])!r});"
        "signal.signal(signal.SIGINT, signal.default_int_handler);"
        f"from fleets.fleet_tasks import {task}; {task}({str(folder)!r})"
    )
    return subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.DEVNULL, start_new_session=True)


def test_a_caller_that_is_killed_goes_on_where_it_was(tmp_path: Path) -> None:
    count, path = 60, tmp_path / "rows.jsonl"
    for least in (5, 15):
        with caller("killed_half_way", tmp_path) as process:
            while len(read_rows(path)) < least:
                assert process.poll() is None
                time.sleep(0.01)
            process.send_signal(signal.SIGKILL)
    with path.open("a") as file:
        file.write('{"key": "00')  # it died while it wrote
    done = len(read_rows(path))
    assert 15 <= done < count
    found = rows_of(tmp_path, work, count, workers=2)
    assert digest(found) == digest(rows_of(tmp_path / "expected", plain, count, workers=1))
    assert len(list((tmp_path / "marks").iterdir())) == count - done


@pytest.mark.parametrize("sent", [signal.SIGKILL, signal.SIGINT])
def test_workers_end_with_their_caller(tmp_path: Path, sent: signal.Signals) -> None:
    marks = tmp_path / "marks"
    marks.mkdir()
    with caller("killed_with_a_pool", tmp_path) as process:
        while len(workers := [int(mark.name) for mark in marks.iterdir()]) < 2:
            assert process.poll() is None
            time.sleep(0.01)
        process.send_signal(sent)
        process.wait(timeout=10.0)
    ends = time.monotonic() + 10.0
    while any(map(running, workers)) and time.monotonic() < ends:
        time.sleep(0.1)
    assert not any(map(running, workers))


def running(process: int) -> bool:
    """Whether a process is there and not merely not yet waited for."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_a_file_that_is_no_table_is_refused(tmp_path: Path) -> None:
    (tmp_path / "rows.jsonl").write_text("not a row\n")
    with pytest.raises(InputError, match="not a table"):
        read_rows(tmp_path / "rows.jsonl")


def test_nobody_at_the_address_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr(import_module("aero_bayes.commands.fleet_runner"), "CONNECT_TIMEOUT", 0.3)
    with pytest.raises(InputError, match="no Dask scheduler"), open_client("tcp://127.0.0.1:9"):
        pass
