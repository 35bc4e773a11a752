"""What the replay of the paper found: rows beside Table 1, curves for Fig. 6, and sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate import Fit
from paper_replay.search import StageEnd

Variant = Literal["paper's values", "recipe rerun", "scaled axes", "joint fit"]
PAPER: Variant = "paper's values"
RERUN: Variant = "recipe rerun"
SCALED: Variant = "scaled axes"
JOINT: Variant = "joint fit"


@dataclass(frozen=True)
class ReplayRow:
    """One model on the paper's experiment.

    Parameters
    ----------
    model : str
        What a table calls it.
    variant : str
        The paper's own numbers; its recipe rerun on our data; the same stages on logarithmic axes (the local search
        with exact slopes); or a joint fit of all outputs that also frees constants Table 1 does not hold.
    parameters : mapping of str to float
        In SI units, with the sign convention of our models (drag opposes the rotation: ``k_d`` positive).
    fitness : float or None
        Eq. 6 of the pitch in rad^2, None where the simulation failed.
    paper_fitness : float or None
        The paper's, on the paper's data.
    note : str
    rms : mapping of str to float
        Error of every output that the model has.
    """

    model: str
    variant: Variant
    parameters: Mapping[str, float]
    fitness: float | None
    paper_fitness: float | None
    note: str
    rms: Mapping[str, float]

    @property
    def label(self) -> str:
        """Model and variant."""
        return f"{self.model}: {self.variant}"


def row_of(rows: Sequence[ReplayRow], model: str, variant: Variant) -> ReplayRow:
    """Return the row of a model and variant."""
    return next(row for row in rows if (row.model, row.variant) == (model, variant))


@dataclass(frozen=True, eq=False)
class Details:
    """The runs behind the sentences: where each stage of each search ended.

    ``endings`` has shape (seeds, iterations): J_r + J_s of the swarm's best in the speed stage, for several seeds;
    ``still`` is the fitness of a pitch that never moves.
    """

    swarm: tuple[StageEnd, ...]
    swarm_scaled: tuple[StageEnd, ...]
    line_search: tuple[StageEnd, ...]
    interior_point: tuple[StageEnd, ...]
    exact: tuple[StageEnd, ...]
    endings: FloatArray
    still: float
    linear: Fit
    quadratic: Fit


@dataclass(frozen=True, eq=False)
class Replay:
    """The paper's Table 1 and Fig. 6 on a simulated bench.

    Parameters
    ----------
    rows : tuple of ReplayRow
        The five models of Table 1, each in its variants, then the models fitted jointly.
    notes : tuple of str
        Short sentences, each with a number from this run.
    time, measured : ndarray, shape (n,)
        Sample times in s and the recorded pitch in rad.
    pitch : mapping of str to ndarray, shape (n,)
        Pitch in rad of the models that Fig. 6 shows.
    details : Details
    failures : mapping of str to int
        Simulations by how they ended.
    seed : int
    seconds : float
    """

    rows: tuple[ReplayRow, ...]
    notes: tuple[str, ...]
    time: FloatArray
    measured: FloatArray
    pitch: Mapping[str, FloatArray]
    details: Details
    failures: Mapping[str, int]
    seed: int
    seconds: float

    def row(self, model: str, variant: Variant) -> ReplayRow:
        """Return a row by name."""
        return row_of(self.rows, model, variant)

    @property
    def series(self) -> dict[str, FloatArray]:
        """Curves for Fig. 6 by their key in series.npz."""
        curves = {"replay/time": self.time, "replay/measured": self.measured}
        return curves | {f"replay/{label}": values for label, values in self.pitch.items()}
