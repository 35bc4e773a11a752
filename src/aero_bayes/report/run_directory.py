"""What a finished run left on disk, read once for drawing. Nothing else feeds the page."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from aero_bayes.errors import InputError

if TYPE_CHECKING:
    import xarray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class RunDirectory:
    """The three files of a run.

    Parameters
    ----------
    path : Path
        The directory.
    result : mapping
        ``result.json`` as it is; every key but ``schema`` may be absent.
    series : mapping of str to ndarray, shape (n,)
        ``series.npz``, keys ``group/recording/signal``; empty where there is no such file.
    posterior : mapping of str to ndarray, shape (ensembles, draws)
        The ``posterior`` group of ``posterior.nc`` in physical units; empty where there is no such file.
    """

    path: Path
    result: Mapping[str, Any]
    series: Mapping[str, FloatArray]
    posterior: Mapping[str, FloatArray]

    @classmethod
    def read(cls, directory: Path | str) -> RunDirectory:
        """Read a run directory.

        Raises
        ------
        InputError
            No ``result.json`` there, or one of the files is damaged.
        """
        path = Path(directory)
        return cls(path, _read_result(path), _read_series(path / "series.npz"), _read_posterior(path / "posterior.nc"))

    def recordings(self) -> tuple[str, ...]:
        """Names of the recordings that have series, training before test, else in file order."""
        drawn = [key.removeprefix("time/") for key in self.series if key.startswith("time/")]
        order = {str(row.get("name")): rank for rank, row in enumerate(table(self.result, "recordings"))}
        return tuple(sorted(drawn, key=lambda name: order.get(name, len(order))))

    def time(self, recording: str) -> FloatArray:
        """Sample times of a recording, shape (n,), in s."""
        return self.series[f"time/{recording}"]

    def signals(self, group: str, recording: str) -> dict[str, FloatArray]:
        """Signals of a group (``measured``, ``fitted``, ...) by name, each of shape (n,).

        Raises
        ------
        InputError
            A signal's length differs from that of the recording's times.
        """
        prefix = f"{group}/{recording}/"
        found = {key.removeprefix(prefix): values for key, values in self.series.items() if key.startswith(prefix)}
        rows = len(self.time(recording))
        for name, values in found.items():
            if values.shape != (rows,):
                raise InputError(
                    f"{self.path / 'series.npz'}: {prefix}{name} has shape {values.shape}, expected ({rows},) "
                    f"as time/{recording}"
                )
        return found


def mapping(node: object, *keys: str) -> dict[str, Any]:
    """The mapping found at ``keys``; an empty one where there is none."""
    for key in keys:
        node = node.get(key) if isinstance(node, Mapping) else None
    return dict(node) if isinstance(node, Mapping) else {}


def table(node: object, *keys: str) -> list[dict[str, Any]]:
    """The list of mappings found at ``keys``; an empty one where there is none."""
    rows = mapping(node, *keys[:-1]).get(keys[-1])
    return [dict(row) for row in rows if isinstance(row, Mapping)] if isinstance(rows, list) else []


def texts(node: object, *keys: str) -> list[str]:
    """The list of strings found at ``keys`` (a lone string counts as a list of one)."""
    found = mapping(node, *keys[:-1]).get(keys[-1])
    if isinstance(found, str):
        return [found]
    return [str(item) for item in found] if isinstance(found, list) else []


def number(value: object) -> float | None:
    """A finite float, or None for anything else (absent, null, text, NaN, infinity)."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if np.isfinite(value) else None


def _read_result(directory: Path) -> dict[str, Any]:
    path = directory / "result.json"
    try:
        result = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{directory}: no result.json there, expected the --out directory of a finished run") from None
    except NotADirectoryError:
        raise InputError(f"{directory}: not a directory, expected the --out directory of a finished run") from None
    except json.JSONDecodeError as error:
        raise InputError(f"{path}: line {error.lineno}, column {error.colno}: not valid JSON: {error.msg}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: not UTF-8 text, expected the JSON that a run writes") from None
    if not isinstance(result, dict):
        raise InputError(f"{path}: holds a {type(result).__name__}, expected an object")
    if result.get("schema", 1) != 1:
        raise InputError(f"{path}: schema {result['schema']!r}, this version draws schema 1")
    return result


def _read_series(path: Path) -> dict[str, FloatArray]:
    if not path.is_file():
        return {}
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {key: np.asarray(archive[key], dtype=np.float64) for key in archive.files}
    except (ValueError, OSError, EOFError, KeyError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: not a readable archive of series ({_first_line(error)})") from None


def _read_posterior(path: Path) -> dict[str, FloatArray]:
    if not path.is_file():
        return {}
    try:
        import xarray  # a second of imports that only a page with a posterior needs

        with xarray.open_dataset(path, group="posterior") as group:
            return {str(name): _flat for name, values in group.items() for name, _flat in _columns(str(name), values)}
    except (ValueError, OSError, KeyError) as error:
        raise InputError(f"{path}: not a readable posterior ({_first_line(error)})") from None


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


def _columns(name: str, values: xarray.DataArray) -> list[tuple[str, FloatArray]]:
    """A variable as matrices (ensembles, draws): one for a scalar, one an element for a vector."""
    if not {"chain", "draw"} <= set(values.dims):
        return []
    draws = np.asarray(values.transpose("chain", "draw", ...).values, dtype=np.float64)
    if draws.ndim == 2:
        return [(name, draws)]
    flat = draws.reshape(*draws.shape[:2], -1)
    return [(f"{name}[{index}]", flat[:, :, index]) for index in range(flat.shape[2])]
