"""Nothing is lost: dead workers, killed callers, restarts and failures all end in the same table."""

from __future__ import annotations

import re
import signal
import sqlite3
import subprocess
import sys
import time
from importlib import import_module
from pathlib import Path

import pytest
from facts import facts
from fleets.fleet_tasks import Count, one_always_dies, plain, work

from aero_bayes.commands.fleet_runner import Table, open_client, run_tasks
from aero_bayes.errors import InputError

pytestmark = pytest.mark.long


def tasks(folder: Path, count: int) -> list[Count]:
    folder.mkdir(exist_ok=True)
    return [Count(k, folder) for k in range(count)]


def expected(folder: Path, count: int) -> str:
    with Table(folder / "expected.sqlite") as table:
        run_tasks(tasks(folder / "none", count), plain, table, workers=1)
        assert len(list(table.rows())) == count
        return table.digest()


@pytest.mark.parametrize("dask", [None, "local"])
def test_workers_that_die_change_nothing(tmp_path: Path, dask: str | None) -> None:
    if dask:
        pytest.importorskip("distributed")
    with open_client(dask, 2) as client, Table(tmp_path / "rows.sqlite") as table:
        run_tasks(tasks(tmp_path / "marks", 8), work, table, client=client, workers=2)
        assert table.digest() == expected(tmp_path, 8)
        assert rows_of(table)["0006"] == {"key": "0006", "error": "ValueError: this one cannot be"}


def test_a_task_that_kills_every_worker_is_a_row_that_says_so(tmp_path: Path) -> None:
    with Table(tmp_path / "rows.sqlite") as table:
        run_tasks([Count(k, tmp_path, 0.3) for k in range(4)], one_always_dies, table, workers=2)
        rows = {key: row.get("error", "") for key, row in rows_of(table).items()}
    assert re.search(facts("worker", "3"), rows.pop("0001"))
    assert set(rows.values()) == {""}


def caller(task: str, folder: Path) -> subprocess.Popen[bytes]:
    """A process of its own, in a session of its own: what Ctrl-C sends reaches it alone."""
    code = (
        f"import sys, signal; sys.path.insert(0, {str(Path(__file__).parents[1])!r});"
        "signal.signal(signal.SIGINT, signal.default_int_handler);"
        f"from fleets.fleet_tasks import {task}; {task}({str(folder)!r})"
    )
    return subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.DEVNULL, start_new_session=True)


def test_a_caller_that_is_killed_goes_on_where_it_was(tmp_path: Path) -> None:
    count, path = 60, tmp_path / "rows.sqlite"
    for least in (5, 15):
        with caller("killed_half_way", tmp_path) as process:
            while not path.exists() or rows_in(path) < least:
                assert process.poll() is None
                time.sleep(0.01)
            process.send_signal(signal.SIGKILL)
    done = rows_in(path)
    assert 15 <= done < count
    (marks := tmp_path / "marks").mkdir()
    with Table(path) as table:
        run_tasks(tasks(marks, count), work, table, workers=2)
        assert table.digest() == expected(tmp_path, count)
    assert len(list(marks.iterdir())) == count - done


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


def rows_in(path: Path) -> int:
    try:
        with Table(path) as table:
            return len(list(table.rows()))
    except sqlite3.OperationalError:  # locked just now
        return 0


def rows_of(table: Table) -> dict[str, dict]:
    return {row["key"]: row for row, _ in table.rows()}


def test_a_row_made_of_something_else_is_made_anew(tmp_path: Path) -> None:
    with Table(tmp_path / "rows.sqlite") as table:
        table.put({"key": "0000", "value": 7.0}, {}, "old")
        table.put({"key": "0001", "value": 7.0}, {}, "new")
        run_tasks([Count(k, tmp_path, made_of="new") for k in range(2)], plain, table, workers=1)
        rows = rows_of(table)
        assert rows["0000"]["value"] != 7.0
        assert rows["0001"]["value"] == 7.0
        table.keep_only({"0001"})
        assert list(rows_of(table)) == ["0001"]


def test_a_file_that_is_no_table_is_refused(tmp_path: Path) -> None:
    (tmp_path / "rows.sqlite").write_text("not a database at all, but long enough to be looked at as one" * 20)
    with pytest.raises(InputError, match="not a table"):
        Table(tmp_path / "rows.sqlite")


def test_nobody_at_the_address_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr(import_module("aero_bayes.commands.fleet_runner"), "CONNECT_TIMEOUT", 0.3)
    with pytest.raises(InputError, match="no Dask scheduler"), open_client("tcp://127.0.0.1:9"):
        pass
