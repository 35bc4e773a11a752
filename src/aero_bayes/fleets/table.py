"""Rows that survive whatever happens to the process that writes them: one SQLite file."""

from __future__ import annotations

import hashlib
import json
import sqlite3
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Self

from aero_bayes.errors import InputError

Row = dict[str, Any]
#: How long a row may wait for others that are written with it, in s.
MAX_COMMIT_DELAY = 0.5
_TABLE = """
CREATE TABLE IF NOT EXISTS rows (
  key TEXT PRIMARY KEY, made_of TEXT NOT NULL, row TEXT NOT NULL, cost TEXT NOT NULL
) WITHOUT ROWID
"""


class Table:
    """Rows by key, in the order of their keys whatever the order in which they came.

    ``row`` holds what is the same however often and wherever it is computed; ``cost`` what it took, and where;
    ``made_of`` a fingerprint of what it was computed from, so that a row made of something else is computed anew."""

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._began = 0.0
        self._database = sqlite3.connect(path, isolation_level=None, timeout=60.0)
        try:
            # No write-ahead log: it does not work on network file systems, where clusters keep their results.
            self._database.execute("PRAGMA journal_mode = TRUNCATE")
            self._database.execute("PRAGMA synchronous = NORMAL")
            self._database.execute(_TABLE)
        except sqlite3.DatabaseError as error:
            self._database.close()
            if isinstance(error, sqlite3.OperationalError):  # the disk, not the file
                raise
            raise InputError(f"{path}: not a table of rows ({error})") from None

    def has(self, key: str, made_of: str = "") -> bool:
        """Tell whether the row is there and was made of just this."""
        found = self._database.execute("SELECT made_of FROM rows WHERE key = ?", (key,)).fetchone()
        return found is not None and bool(found[0] == made_of)

    def put(self, row: Row, cost: Mapping[str, Any], made_of: str = "") -> None:
        """Write a row, which carries its key under ``key``, whole or not at all.

        It is safe once :meth:`flush` was called, or the next row comes :data:`MAX_COMMIT_DELAY` later."""
        texts = (json.dumps(row, sort_keys=True), json.dumps(cost, sort_keys=True))
        if not self._database.in_transaction:
            self._database.execute("BEGIN")
            self._began = time.monotonic()
        self._database.execute("REPLACE INTO rows VALUES (?, ?, ?, ?)", (row["key"], made_of, *texts))
        if time.monotonic() - self._began > MAX_COMMIT_DELAY:
            self.flush()

    def flush(self) -> None:
        """Have the disk hold all rows: a few milliseconds and more, which many short tasks share."""
        if self._database.in_transaction:
            self._database.execute("COMMIT")

    def get(self, key: str) -> Row | None:
        """Read one row."""
        found = self._database.execute("SELECT row FROM rows WHERE key = ?", (key,)).fetchone()
        return json.loads(found[0]) if found is not None else None

    def rows(self) -> Iterator[Row]:
        """Read all rows, one at a time."""
        for (text,) in self._database.execute("SELECT row FROM rows ORDER BY key"):
            yield json.loads(text)

    def costs(self) -> Iterator[Row]:
        """Read the costs of all rows, one at a time."""
        for (text,) in self._database.execute("SELECT cost FROM rows ORDER BY key"):
            yield json.loads(text)

    def keep_only(self, keys: set[str]) -> None:
        """Drop rows of other keys."""
        present = {key for (key,) in self._database.execute("SELECT key FROM rows")}
        self._database.executemany("DELETE FROM rows WHERE key = ?", [(key,) for key in present - keys])

    def digest(self) -> str:
        """Hash all rows, costs left out: equal for equal tables."""
        total = hashlib.sha256()
        for key, text in self._database.execute("SELECT key, row FROM rows ORDER BY key"):
            total.update(f"{key}\0{text}\n".encode())
        return total.hexdigest()

    def __len__(self) -> int:
        return int(self._database.execute("SELECT COUNT(*) FROM rows").fetchone()[0])

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.flush()
        self._database.close()
