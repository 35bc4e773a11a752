"""Read the files of a finished run; the page is drawn from nothing else."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import ValidationError

from aero_bayes.arguments import paths_of
from aero_bayes.arrays import FloatArray
from aero_bayes.data.recording import Recording
from aero_bayes.display import table_html
from aero_bayes.errors import InputError
from aero_bayes.estimate.prediction import RecordingPrediction
from aero_bayes.estimate.simulate import simulate
from aero_bayes.estimate.stored_fit import StoredFit, stored
from aero_bayes.figures import HasPage, Picture, drawn
from aero_bayes.plain import plain
from aero_bayes.report.schema_run import SCHEMA, RunJson

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True)
class RunDirectory(HasPage):
    """Files of a finished run: its result, curves and draws.

    Parameters
    ----------
    path : Path
        The directory.
    result : RunJson
        ``result.json``.
    series : mapping of str to ndarray, shape (n,)
        ``series.npz``, keys ``group/recording/signal``; empty where there is no such file.
    posterior : mapping of str to ndarray, shape (ensembles, draws)
        The ``posterior`` group of ``posterior.nc`` in physical units; empty where there is no such file.

    Examples
    --------
    >>> run.result.command, run.result.parameters["k"].unit
    ('close-loop', 'N/m')
    >>> run.result.loop.effects[0].id
    'coulomb_friction@v'
    >>> aero_bayes.RunDirectory.read("out/loop").recordings()
    ('train', 'test')
    >>> run.span("test"), run.unseen("test"), run.unseen("train")
    ((0.0, 40.0), (20.0, 40.0), None)
    >>> list(run.signals("fitted", "test")), run.time("test").shape
    (['position'], (2001,))
    >>> run.check("measured/test/position", "test")  # as long as its times
    """

    path: Path
    result: RunJson
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
        (path,) = paths_of(directory, "directory")
        return cls(path, _read_result(path), _read_series(path / "series.npz"), _read_posterior(path / "posterior.nc"))

    def predict(
        self,
        inputs: Recording | Mapping[str, ArrayLike],
        *,
        draws: int = 200,
        seed: int = 1,
        workers: int | None = 0,
    ) -> RecordingPrediction:
        """Predict readings with a 90 % band, as the fit of the run does, or its posterior where there is one.

        Parameters
        ----------
        inputs, draws, seed, workers
            As for :meth:`Fit.predict`.

        Returns
        -------
        RecordingPrediction

        Raises
        ------
        InputError
            If the run left no model that can be run.

        Examples
        --------
        >>> run.predict(test, draws=20).to_frame().shape == (test.rows, 3)
        True
        """
        points = self._fit.points(draws, seed, self.posterior)
        return self._fit.predictor.predict(points, inputs, seed=seed, workers=workers)

    def simulate(
        self,
        inputs: Recording | Mapping[str, ArrayLike],
        *,
        parameters: Mapping[str, float] | None = None,
        start: Mapping[str, float] | None = None,
    ) -> Recording:
        """Run the fitted model on other inputs, as :meth:`Fit.simulate` does.

        Parameters
        ----------
        inputs, parameters, start
            As for :meth:`Fit.simulate`.

        Returns
        -------
        Recording

        Raises
        ------
        InputError
            If the run left no model that can be run.

        Examples
        --------
        >>> list(run.simulate(test, parameters={"k": 100.0}).outputs)
        ['position']
        """
        p = self._fit.predictor
        return simulate(p.calibration, p.values, inputs, p.noise, parameters=parameters, start=start)

    @cached_property
    def _fit(self) -> StoredFit:
        return stored(self.path)

    def to_arviz(self) -> Any:
        """Return the draws as ArviZ opens them from ``posterior.nc``: InferenceData, from ArviZ 1.0 on a DataTree.

        Raises
        ------
        InputError
            If the run left no draws: only ``posterior`` and ``all`` do.

        Examples
        --------
        >>> run.to_arviz()  # of a close-loop
        Traceback (most recent call last):
        aero_bayes.errors.InputError: ...: the run has no posterior.nc; aero-bayes posterior writes one
        """
        from aero_bayes.estimate.posterior import load

        path = self.path / "posterior.nc"
        if not path.is_file():
            raise InputError(f"{self.path}: the run has no posterior.nc; aero-bayes posterior writes one")
        return load(path)

    def plot(self, recording: str | None = None, *, dark: bool = False) -> Picture:
        """Draw the picture that the page opens with, or one recording with all its inputs and outputs.

        Parameters
        ----------
        recording : str, optional
            Name of a recording.
        dark : bool
            Colours for a dark background.

        Returns
        -------
        Picture

        Raises
        ------
        InputError
            For a recording that the run does not know, or a run without curves.

        Examples
        --------
        >>> run.plot().save("run.svg").name
        'run.svg'
        >>> len(run.plot("test").panels)  # the force, the position, what is left of it
        3
        """
        if recording is None:
            return drawn("scene_picture", self, dark=dark)
        return drawn("run_picture", self, recording, dark=dark)

    def to_frame(self) -> pandas.DataFrame:
        """Return a row for each parameter: value, standard deviation, quantiles (SI), unit, status, prior, bounds.

        Examples
        --------
        >>> run.to_frame().loc["k", "unit"]
        'N/m'
        """
        import pandas

        rows = {name: plain(entry) for name, entry in self.result.parameters.items()}
        return pandas.DataFrame.from_dict(rows, orient="index").rename_axis("parameter")

    def __repr__(self) -> str:
        result = self.result
        verdict = f": {result.verdict.text.partition('. ')[0]}" if result.verdict is not None else ""
        return f"<RunDirectory {self.path.name}, {result.command} of {result.model.name}{verdict}>"

    def _repr_html_(self) -> str:
        entries = self.result.parameters.items()
        rows = [
            (n, *("" if x is None else f"{x:.4g}" for x in (p.value, p.q05, p.q95)), p.unit, p.status)
            for n, p in entries
        ]
        head = ("parameter", "value", "5 %", "95 %", "unit", "status")
        return table_html(head, rows, repr(self).strip("<>"), self.result.warnings)

    def recordings(self) -> tuple[str, ...]:
        """Return names of the recordings that have series, training before test, else in file order."""
        drawn = [key.removeprefix("time/") for key in self.series if key.startswith("time/")]
        order = {row.name: rank for rank, row in enumerate(self.result.recordings)}
        return tuple(sorted(drawn, key=lambda name: order.get(name, len(order))))

    def time(self, recording: str) -> FloatArray:
        """Return sample times of a recording, shape (n,), in s."""
        return self.series[f"time/{recording}"]

    def span(self, recording: str) -> tuple[float, float]:
        """Return the first and last sample time of a recording, in s."""
        time = self.time(recording)
        return float(time[0]), float(time[-1])

    def unseen(self, recording: str) -> tuple[float, float] | None:
        """Return the stretch of a recording that is judged on, in s: its test part, or what validates; None if it has
        none."""
        first, last = self.span(recording)
        parts = [p for p in (self.result.loop.parts if self.result.loop else ()) if p.recording == recording]
        for role in ("test", "validation"):
            for part in parts:
                if part.role == role:
                    begin, end = (x if x is not None else edge for x, edge in ((part.begin, first), (part.end, last)))
                    return begin, end
        return (first, last) if not parts and self.result.role(recording) in ("test", "validation") else None

    def signals(self, group: str, recording: str) -> dict[str, FloatArray]:
        """Return signals of a ``group`` (``measured``, ``fitted``, ...) of a ``recording`` by name, each of shape (n,).

        Raises
        ------
        InputError
            A signal's length differs from that of the recording's times.
        """
        prefix = f"{group}/{recording}/"
        found = {key.removeprefix(prefix): values for key, values in self.series.items() if key.startswith(prefix)}
        for name in found:
            self.check(f"{prefix}{name}", recording)
        return found

    def check(self, key: str, recording: str) -> None:
        """Raise InputError where the series ``key`` is not as long as the times of its ``recording``."""
        rows = len(self.time(recording))
        if self.series[key].shape != (rows,):
            raise InputError(
                f"{self.path / 'series.npz'}: {key} has shape {self.series[key].shape}, expected ({rows},) "
                f"as time/{recording}"
            )


def _read_result(directory: Path) -> RunJson:
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
    if result.get("schema", SCHEMA) != SCHEMA:
        raise InputError(f"{path}: schema {result['schema']!r}, this version draws schema {SCHEMA}")
    try:
        return RunJson.model_validate(result)
    except ValidationError as error:
        problem = error.errors()[0]
        raise InputError(f"{path}: {'.'.join(map(str, problem['loc']))}: {problem['msg'].lower()}") from None


def _read_series(path: Path) -> dict[str, FloatArray]:
    if not path.is_file():
        return {}
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {key: np.asarray(archive[key], dtype=np.float64) for key in archive.files}
    except (ValueError, OSError, EOFError, KeyError, zipfile.BadZipFile) as error:
        why = next(iter(str(error).splitlines()), type(error).__name__)
        raise InputError(f"{path}: not a readable archive of series ({why})") from None


def _read_posterior(path: Path) -> dict[str, FloatArray]:
    if not path.is_file():
        return {}
    from aero_bayes.estimate.posterior import draws_in

    try:
        return draws_in(path)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
