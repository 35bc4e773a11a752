"""A parameter with its interval and status, and tables of parameters for readers."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from aero_bayes.arrays import FloatArray
from aero_bayes.display import join_names, table_html
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.delays import MIN_INFORMATION, StepParameter
from aero_bayes.plain import INTERNAL, Number, plain
from aero_bayes.simulation.interface import ParameterTarget
from aero_bayes.simulation.model import Model

#: Posterior over prior standard deviation below which a parameter counts as identified, and above which as not at all.
IDENTIFIED_BELOW, UNIDENTIFIED_ABOVE = 1.0 / 3.0, 0.95
#: Eigenvalue of the scaled information below which its direction counts as collinear: the estimate then depends on so
#: small a part of the readings that a small model error changes it. And the smallest component with which a parameter
#: belongs to such a direction.
MAX_COLLINEAR_SHARE, MIN_PART = 1e-5, 0.1
#: Standard deviation of a value by a common change, over its size, from which the change is told.
MIN_MOVE = 0.005

#: Why a parameter has no interval whose derivative is none.
NO_DERIVATIVE = "no interval: the model switches, and its differences over a small step and a large one do not agree"
#: Note of a parameter whose interval a rounding makes.
ROUNDED = "most of its interval comes from the rounding of a corner in the model, as that of friction at rest"
#: Note of a parameter that a known fault of the data moves.
BIASED = "the noise of an input biases it: its interval holds for an input without"
#: Notes of an interval without an upper and without a lower end, to be filled with ``(q05, q95, lower, upper)``.
OPEN_ENDS = (
    "one-sided interval, > {0}: the readings do not tell larger values apart, up to the bound {3}",
    "one-sided interval, < {1}: the readings do not tell smaller values apart, down to the bound {2}",
)


class Status(StrEnum):
    """How well the data determine a parameter."""

    IDENTIFIED = "identified"
    WEAK = "weak"
    UNIDENTIFIED = "unidentified"
    FIXED = "fixed"
    AT_BOUND = "at_bound"


@dataclass(frozen=True)
class Combination:
    """A combination of parameters that the data determine although they do not determine its members."""

    text: str
    members: tuple[str, ...]
    sd_relative: Number


@dataclass(frozen=True)
class FlatDirection:
    """Parameters of which one or several common ``changes`` hardly alter the outputs.

    ``by_prior``: the prior knows more of each of them than the readings."""

    members: tuple[str, ...]
    changes: int = 1
    by_prior: bool = False

    @property
    def sentence(self) -> str:
        """What a reader should know."""
        names = _listed(self.members)
        it = "it" if self.changes == 1 else "them"
        slight = f"the readings tell {it} so slightly that a small error of the model or of a held value decides"
        decides = f"the readings do not tell {it}, and the prior decides" if self.by_prior else slight
        up_to = "a common change" if self.changes == 1 else f"{self.changes} common changes"
        return f"{names} are known up to {up_to} only: {decides}."


@dataclass(frozen=True)
class Identifiability:
    """Verdict by parameter: ``status``, and ``ratio`` of posterior to prior standard deviation (search axes).

    ``no_effect`` names parameters that change no output; ``flat`` are directions that the data hardly determine;
    ``steps`` are parameters that act in steps; ``with_held`` has the parameters that the data show only together with
    a value that is held, and a sentence on each."""

    status: dict[str, Status]
    ratio: dict[str, float]
    combinations: tuple[Combination, ...]
    no_effect: tuple[str, ...]
    flat: tuple[FlatDirection, ...] = ()
    steps: tuple[StepParameter, ...] = ()
    with_held: Mapping[str, str] = field(default_factory=dict)

    @property
    def in_steps(self) -> dict[str, StepParameter]:
        """Parameters that act in steps, by name."""
        return {step.name: step for step in self.steps}

    def with_steps(self, steps: tuple[StepParameter, ...]) -> Identifiability:
        """Tell parameters that act in steps, without a slope, apart from those without an effect."""
        names = {step.name for step in steps}
        return replace(self, steps=steps, no_effect=tuple(name for name in self.no_effect if name not in names))

    def capped(self, name: str, status: Status) -> Status:
        """Return the status of a parameter, at best weak in a flat direction, or beside a held value like it."""
        flat = name in self.with_held or any(name in direction.members for direction in self.flat)
        return Status.WEAK if flat and status is Status.IDENTIFIED else status

    def beside_held(self, notes: Mapping[str, str]) -> Identifiability:
        """Return the verdict with the sentences on parameters that are seen only together with a held value."""
        found = replace(self, with_held=dict(notes))
        return replace(found, status={name: found.capped(name, one) for name, one in self.status.items()})

    def sentences(self, held: Sequence[str] = ()) -> tuple[str, ...]:
        """Return what a reader should know, one sentence each.

        ``held`` names those that were then left at their start."""
        lines = [f"`{name}` changes no recorded output: it cannot be determined." for name in self.no_effect]
        lines += [f"`{step.name}` {step.note}." for step in self.steps]
        lines += [direction.sentence for direction in self.flat]
        for members in dict.fromkeys(c.members for c in self.combinations):
            lines.append(_determined(members, [c.text for c in self.combinations if c.members == members]))
        lines += [f"`{name}` is known {note}." for name, note in self.with_held.items()]
        told = {*held, *self.with_held, *(name for direction in self.flat for name in direction.members)}
        weak = [n for n, s in self.status.items() if s is Status.WEAK and n not in told]
        if weak:
            lines.append(f"The readings determine {_listed(weak)} only weakly, so that the prior matters.")
        left = [n for n in held if n not in self.no_effect]
        if left:
            lines.append(f"The readings do not show {_listed(left)}: left at the start.")
        return tuple(lines)

    def to_dict(self, held: Sequence[str] = ()) -> dict[str, object]:
        """Return the ``identifiability`` entry of result.json; ``held`` as in :meth:`sentences`."""
        return {
            "combinations": plain(self.combinations),
            "unidentified": [n for n, s in self.status.items() if s is Status.UNIDENTIFIED or n in held],
            "flat": [direction.sentence for direction in self.flat],
            "text": list(self.sentences(held)),
        }


def status_of(ratio: float) -> Status:
    """Judge a ratio of posterior to prior standard deviation."""
    if ratio > UNIDENTIFIED_ABOVE:
        return Status.UNIDENTIFIED
    return Status.WEAK if ratio > IDENTIFIED_BELOW else Status.IDENTIFIED


def _determined(members: Sequence[str], texts: Sequence[str]) -> str:
    """Return what is determined of parameters that are not seen apart."""
    alone = [name for name in members if name in texts]
    if len(texts) == 1 and not alone:
        names = re.compile("|".join(rf"(?<!\w){re.escape(name)}(?!\w)" for name in members))
        marked = names.sub(lambda found: f"`{found[0]}`", texts[0])
        return f"Only the combination {marked} is determined, not its members."
    lost = [name for name in members if name not in alone]
    if not lost:
        return f"{_listed(alone)} {'is' if len(alone) == 1 else 'are'} determined."
    seen = f"{_listed(texts)} {'is' if len(texts) == 1 else 'are'} determined"
    return f"{seen}; {_listed(lost)} cannot be told apart." if len(lost) > 1 else f"{seen}, {_listed(lost)} is not."


def _listed(words: Sequence[str]) -> str:
    """Return names, marked as such, in a sentence."""
    return join_names([f"`{word}`" for word in words])


def assess(
    names: Sequence[str],
    values: FloatArray,
    logarithmic: Sequence[bool],
    information: FloatArray,
    prior_sd: FloatArray,
) -> Identifiability:
    """Assess which parameters the data determine."""
    scaled = information * prior_sd[:, None] * prior_sd[None, :]
    diagonal = np.diag(scaled)
    blind = diagonal < MIN_INFORMATION
    eigenvalues, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
    eigenvalues = np.maximum(eigenvalues, 0.0)
    posterior = np.sqrt(np.sum(vectors**2 / (1.0 + eigenvalues), axis=1))
    status: dict[str, Status] = {}
    for j, name in enumerate(names):
        status[name] = Status.UNIDENTIFIED if blind[j] else status_of(float(posterior[j]))
    ratio = {name: float(posterior[j]) for j, name in enumerate(names)}
    found = Identifiability(
        status,
        ratio,
        _combinations(names, values, logarithmic, information, prior_sd, ~blind),
        tuple(name for j, name in enumerate(names) if blind[j]),
        _flat(
            [n for j, n in enumerate(names) if not blind[j]],
            np.where(logarithmic, 1.0, np.abs(values))[~blind],
            information[np.ix_(~blind, ~blind)],
            prior_sd[~blind],
        ),
    )
    return replace(found, status={name: found.capped(name, one) for name, one in status.items()})


def _flat(
    names: Sequence[str], size_of: FloatArray, information: FloatArray, prior_sd: FloatArray
) -> tuple[FlatDirection, ...]:
    """Find directions along which the parameters compensate each other: eigenvectors, of small eigenvalues, of the
    information scaled to a unit diagonal (Belsley, Kuh & Welsch, 1980, Regression Diagnostics).

    Where the readings tell each value (of ``size_of``) closely even so, as of a chaotic system, there is none."""
    if len(names) < 2:
        return ()
    norm = np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = information / np.outer(norm, norm)
    sizes, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
    found: list[tuple[set[str], int, bool]] = []
    for size, v in zip(np.maximum(sizes, 0.0), vectors.T, strict=True):
        part_of = np.where(np.abs(v) > MIN_PART, np.abs(v), 0.0)
        moves = float(np.max(part_of / np.maximum(norm * size_of, 1e-300))) / math.sqrt(max(size, 1e-300))
        if size < MAX_COLLINEAR_SHARE and moves > MIN_MOVE:
            members, changes = {n for n, part in zip(names, np.abs(v), strict=True) if part > MIN_PART}, 1
            by_prior = float(np.sum(v**2 / (prior_sd**2 * np.diag(information)))) > size
            for other in [one for one in found if one[0] & members]:  # directions that share members are one plane
                found.remove(other)
                members, changes, by_prior = members | other[0], changes + other[1], by_prior and other[2]
            found.append((members, changes, by_prior))
    return tuple(FlatDirection(tuple(n for n in names if n in m), changes, by) for m, changes, by in found)


def _combinations(
    names: Sequence[str],
    values: FloatArray,
    logarithmic: Sequence[bool],
    information: FloatArray,
    prior_sd: FloatArray,
    seen: NDArray[np.bool_],
) -> tuple[Combination, ...]:
    """Find combinations that are determined of parameters whose common changes leave the outputs as they are."""
    columns = [int(j) for j in np.flatnonzero(seen) if logarithmic[int(j)]]
    if len(columns) < 2:
        return ()
    covariance = np.linalg.pinv(information + np.diag(1.0 / prior_sd**2), hermitian=True)
    norm = np.sqrt(np.diag(information)[columns])
    correlation = information[np.ix_(columns, columns)] / np.outer(norm, norm)
    eigenvalues, vectors = np.linalg.eigh(0.5 * (correlation + correlation.T))
    found = []
    null = vectors[:, eigenvalues < 1e-9 * len(columns)] / norm[:, None]
    for members in _groups(null):
        block = null[members][:, np.abs(null[members]).max(axis=0) > 1e-6 * np.abs(null).max()]
        if block.shape[1] == 0:  # beside the others they hardly move
            continue
        group = [columns[k] for k in members]
        for text, row in _names(names, values, group, block):
            spread = float(np.sqrt(row @ covariance[np.ix_(group, group)] @ row))
            if spread > IDENTIFIED_BELOW * float(np.linalg.norm(row * prior_sd[group])):
                continue  # only the prior knows it
            found.append(Combination(text, tuple(names[j] for j in group), spread))
    return tuple(found)


def _groups(null: FloatArray) -> list[list[int]]:
    """Find sets of parameters that share null directions."""
    if null.shape[1] == 0:
        return []
    projector = null @ np.linalg.pinv(null)
    linked = np.abs(projector) > 1e-4
    groups: list[list[int]] = []
    left = {k for k in range(len(null)) if linked[k, k]}
    while left:
        group, frontier = set(), {min(left)}
        while frontier:
            k = frontier.pop()
            group.add(k)
            frontier |= {int(m) for m in np.flatnonzero(linked[k])} - group
        groups.append(sorted(group))
        left -= group
    return groups


def _names(
    names: Sequence[str], values: FloatArray, group: Sequence[int], null: FloatArray
) -> list[tuple[str, FloatArray]]:
    """Name products of powers, or sums, that null directions leave as they are, with their gradient on log axes."""
    basis = np.linalg.svd(null.T)[2][np.linalg.matrix_rank(null, tol=1e-8 * np.abs(null).max()) :]
    found = []
    for row in _reduced(basis):
        lead = row / np.abs(row).max()
        rounded = np.round(lead)
        share = row / values[list(group)]
        share = share / share[int(np.argmax(np.abs(share)))]
        kept = np.abs(share) > 1e-3
        if np.allclose(lead, rounded, atol=1e-3):
            text = _product([(names[j], int(r)) for j, r in zip(group, rounded, strict=True) if r])
        elif np.allclose(share[kept], 1.0, atol=1e-2):
            text, lead = " + ".join(names[j] for j, k in zip(group, kept, strict=True) if k), row / row.sum()
        else:
            text = "a function of " + ", ".join(names[j] for j, r in zip(group, lead, strict=True) if abs(r) > 1e-3)
        found.append((text, lead))
    return found


def _reduced(rows: FloatArray) -> FloatArray:
    """Reduce rows, so that small whole exponents show where there are some."""
    rows = rows.copy()
    pivot = 0
    for column in range(rows.shape[1]):
        if pivot == rows.shape[0]:
            break
        best = pivot + int(np.argmax(np.abs(rows[pivot:, column])))
        if abs(rows[best, column]) < 1e-6:
            continue
        rows[[pivot, best]] = rows[[best, pivot]]
        rows[pivot] /= rows[pivot, column]
        for other in range(rows.shape[0]):
            if other != pivot:
                rows[other] -= rows[other, column] * rows[pivot]
        pivot += 1
    rows[np.abs(rows) < 1e-6] = 0.0
    return rows


def _product(powers: Sequence[tuple[str, int]]) -> str:
    if sum(p for _, p in powers) < 0 or all(p < 0 for _, p in powers):
        powers = [(n, -p) for n, p in powers]
    top = [n if p == 1 else f"{n}^{p}" for n, p in powers if p > 0]
    bottom = [n if p == -1 else f"{n}^{-p}" for n, p in powers if p < 0]
    return " ".join(top or ["1"]) + (" / " + " ".join(bottom) if bottom else "")


Json = dict[str, object]


@dataclass(frozen=True)
class Estimate:
    """Value and interval of one parameter; ``sd`` and the quantiles are None where the data do not determine it."""

    name: str = field(metadata=INTERNAL)
    value: Number
    sd: float | None = None
    q05: float | None = None
    q50: float | None = None
    q95: float | None = None
    unit: str = ""
    status: Status = Status.IDENTIFIED
    description: str = ""
    prior: str = ""
    start: float | None = None
    lower: float | None = None
    upper: float | None = None
    note: str = ""
    recording: str = ""

    @classmethod
    def held(
        cls, name: str, value: float, unit: str, note: str, description: str = "", recording: str = ""
    ) -> Estimate:
        """Return the entry of a parameter that is not fitted, with the reason."""
        no = None, None, None, None
        return cls(name, value, *no, unit, Status.FIXED, description, note=note, recording=recording)

    def with_note(self, note: str) -> Estimate:
        """Return the estimate with one more note."""
        return replace(self, note="; ".join(filter(None, (self.note, note))))

    def with_failed_interval(self, note: str) -> Estimate:
        """Return the estimate with what is wrong with its interval, which it loses where it has none or one end."""
        ends = (f"{end:.4g}" for end in (self.q05, self.q95, self.lower, self.upper) if end is not None)
        told = self.with_note(note.format(*ends) if note in OPEN_ENDS else note).note
        # One status, which no note beside it denies.
        status = Status.WEAK if self.status is Status.IDENTIFIED else self.status
        if note != NO_DERIVATIVE and note not in OPEN_ENDS:
            return replace(self, note=told, status=status)
        return replace(self, status=status, note=told, sd=None, q05=None, q50=None, q95=None)

    def __float__(self) -> float:
        return self.value


def estimates_html(table: Mapping[str, Estimate], caption: str, warnings: Sequence[str] = ()) -> str:
    """Return a table of parameters for a notebook."""
    rows = []
    for e in table.values():
        span = "" if e.q05 is None or e.q95 is None else f"{e.q05:.4g} to {e.q95:.4g}"
        rows.append((e.name, f"{e.value:.4g}", span, e.unit, str(e.status), e.prior))
    return table_html(("parameter", "value", "90 % interval", "unit", "status", "prior"), rows, caption, warnings)


def fixed_reasons(model: Model, fixed: Collection[str]) -> dict[str, str]:
    """Say why parameters of a model are not fitted, by name; ``fixed`` are those that the configuration sets."""
    return {name: "held at the value that the configuration gives" for name in fixed} | dict(model.declared.fixed)


def fixed_parameters(calibration: Calibration) -> dict[str, Estimate]:
    """List parameters of the model that are not fitted, where the reason is known."""
    fitted = {p.target.name for p in calibration.parameters if isinstance(p.target, ParameterTarget)}
    reasons = fixed_reasons(calibration.model, calibration.fixed)
    table = {}
    for v in calibration.model.parameters:
        value, note = calibration.fixed.get(v.name, v.start), reasons.get(v.name)
        if v.name not in fitted and note is not None and value is not None:
            table[v.name] = Estimate.held(v.name, float(value), v.unit, note, v.description)
    for recording in calibration.data.recordings:
        for name, value in recording.known.items():
            v = calibration.model.parameter(name)
            own, told = f"{name}@{recording.name}", "known in this recording"
            table[own] = Estimate.held(own, value, v.unit, told, v.description, recording.name)
    return table
