"""The table of rigs: names, recordings, and settings of each."""

from __future__ import annotations

import csv
import hashlib
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from aero_bayes.config import Config, Section, read_toml, resolve_paths, validated
from aero_bayes.errors import InputError

Work = Literal["fit", "posterior", "loop", "all"]
#: A rig's name is also the name of its folder.
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.+-]{0,99}")
#: Columns of a table of rigs that are no settings, and what stands between several files in one cell.
TABLE_COLUMNS, BETWEEN = ("name", "train", "test"), ";"


class RigSection(Section):
    """``[[rig]]``: a rig, its recordings, and in ``settings`` whatever it has otherwise than the rest of the file."""

    name: str
    train: tuple[Path, ...]
    test: tuple[Path, ...] = ()
    settings: dict[str, Any] = {}  # noqa: RUF012  (pydantic copies defaults)


class FleetSection(Section):
    """``[fleet]``: the work on each rig, and the file of the table of rigs if it is another one.

    ``work`` is one of the commands: fit, posterior, loop, or all three."""

    work: Work = "fit"
    rigs: Path | None = None


class FleetFile(Section):
    """What a fleet's file holds beside what any configuration may."""

    fleet: FleetSection = FleetSection()
    rig: tuple[RigSection, ...] = ()


@dataclass(frozen=True)
class Rig:
    """One rig.

    Parameters
    ----------
    name : str
        Unique; letters, digits and ``_ . + -``.
    train, test : tuple of Path
        Recordings to learn from, and to judge on.
    settings : mapping
        Tables of the configuration that are different for this rig, nested as in the file.

    Examples
    --------
    >>> rig = aero_bayes.Rig("cart-7", (Path("train.csv"),), settings={"parameters": {"k": {"free": True}}})
    >>> rig.seed(1) == aero_bayes.Rig("cart-7", (Path("elsewhere.csv"),)).seed(1)
    True
    """

    name: str
    train: tuple[Path, ...]
    test: tuple[Path, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not NAME.fullmatch(self.name):
            raise InputError(f"rig {self.name!r}: expected a name of letters, digits and _ . + - the first no sign")

    def seed(self, seed: int) -> int:
        """Derive the rig's own seed: it depends on its name, not on its place in the table or on who works on it."""
        return int.from_bytes(hashlib.sha256(f"{seed}/{self.name}".encode()).digest()[:4], "big")


@dataclass(frozen=True)
class FleetPlan:
    """Settings of all rigs with the folder that paths in them start from, the work, and the rigs."""

    shared: Mapping[str, Any]
    folder: Path
    work: Work
    rigs: Sequence[Rig]

    def config(self, rig: Rig) -> Config:
        """Merge the settings of one rig. Raises InputError if they name a key or value that does not exist."""
        document = _overlaid(self.shared, rig.settings)
        return resolve_paths(validated(Config, document, f"rig {rig.name}"), self.folder)


def read_fleet(path: Path) -> FleetPlan:
    """Read ``fleet.toml``: any configuration, with ``[fleet]`` and the rigs."""
    document = read_toml(path)
    own = validated(FleetFile, {key: document.pop(key) for key in ("fleet", "rig") if key in document}, path)
    validated(Config, document, path)
    rigs = [Rig(one.name, one.train, one.test, one.settings) for one in own.rig]
    if own.fleet.rigs is not None:
        rigs += _read_table(path.parent / own.fleet.rigs)
    if not rigs:
        raise InputError(f"{path}: no rigs; expected [[rig]] tables, or [fleet] rigs = a CSV file")
    return FleetPlan(document, path.parent.resolve(), own.fleet.work, rigs)


def _read_table(path: Path) -> list[Rig]:
    """Read the rigs of a CSV file. Raises InputError that names file and row."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            reader = csv.DictReader(stream)
            if missing := [c for c in TABLE_COLUMNS[:2] if c not in (reader.fieldnames or ())]:
                raise InputError(f"{path}: no column {missing[0]}; expected {', '.join(TABLE_COLUMNS)}")
            return [_rig_of_row(row, f"{path}: row {reader.line_num}") for row in reader]
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: not UTF-8 text") from None


def _rig_of_row(row: Mapping[str, str | None], where: str) -> Rig:
    if None in row:
        raise InputError(f"{where}: more cells than columns")
    train, test = (tuple(Path(part.strip()) for part in (row.get(c) or "").split(BETWEEN) if part.strip())
                   for c in TABLE_COLUMNS[1:])  # fmt: skip
    settings: dict[str, Any] = {}
    for key, text in row.items():
        if key not in TABLE_COLUMNS and text:
            # parameters."spring.k".value -> its three parts, as TOML would read them
            *tables, last = [quoted or plain for quoted, plain in re.findall(r'"([^"]*)"|([^".]+)', key)] or [key]
            table = settings
            for name in tables:
                table = table.setdefault(name, {})
            try:
                table[last] = tomllib.loads(f"x = {text}")["x"]
            except tomllib.TOMLDecodeError:
                table[last] = text  # a word without quotes
    try:
        return Rig((row["name"] or "").strip(), train, test, settings)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _overlaid(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Merge nested tables, the upper ones winning key by key."""
    merged = dict(below)
    for key, value in above.items():
        nested = isinstance(value, Mapping) and isinstance(merged.get(key), Mapping)
        merged[key] = _overlaid(merged[key], value) if nested else value
    return merged
