"""A model with some candidates at hand, held against the recordings; fits on one stand start on another by name."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.climb import ClimbSettings, Optimum, climb
from aero_bayes.estimate.growing import OpenSimulator, over_floor
from aero_bayes.estimate.interpolation import read_otherwise
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.loop.starting import Around
from aero_bayes.loop.workbench import Workbench
from aero_bayes.physics.kin import Candidate
from aero_bayes.sensors.noise import OutputNoise

FloatArray = NDArray[np.float64]

#: Tolerance of a finer solution over the present one, and how large the solver's error may be, in units of the noise.
FINER, SHOWS = 1e-3, 0.3
#: How many times the noise floor a fit leaves where it, or what explains it best, may stand in a wrong valley.
FAR = 5.0
#: Share of the range of a law's shape that its standard deviation stays below where the data tell it.
TOLD = 0.5


@dataclass(frozen=True, eq=False)
class Held:
    """A fit of the model with some effects: the stand that it was made on, the effects, and the optimum there."""

    stand: Stand
    effects: tuple[str, ...]
    optimum: Optimum

    @property
    def values(self) -> dict[str, float]:
        """SI values by name; those of candidates that are off are their off values."""
        parameters = self.stand.study.parameters
        return dict(zip(parameters.names, parameters.from_search(self.optimum.coordinates).tolist(), strict=True))

    @property
    def log_evidence(self) -> float:
        return self.optimum.log_evidence

    @cached_property
    def around(self) -> Around:
        """How its parameters readjust: what every candidate beside it starts from."""
        return Around(self.stand.study, self.optimum)

    @cached_property
    def untouched(self) -> Around | None:
        """The model's own values, where no effect explains why a fit is far off: it may have led them astray."""
        if self.effects or over_floor(self.stand.study, self.optimum.evaluation.residual) < FAR:
            return None
        return self.at({}, self.optimum.noise)

    def at(self, values: Mapping[str, float], noise: Mapping[str, OutputNoise]) -> Around | None:
        """Other values by name with the same effects on; None where they cannot be simulated."""
        at, study = self.stand.at(values, self.effects), self.stand.study
        evaluation = study.evaluate(at, self.optimum.free)
        if evaluation is None:
            return None
        whitened = study.whiten(evaluation.residual, evaluation.slopes, noise)
        place = replace(self.optimum, coordinates=at, noise=noise, evaluation=evaluation, whitened=whitened)
        return Around(study, place)

    def shows_shape(self, id_: str) -> bool:
        """Whether every shape of a law is told by the data, and not on its bound, where it may be another law; some may
        vanish."""
        candidate, parameters = self.stand.candidates[id_], self.stand.study.parameters
        shapes = [j for k, j in enumerate(candidate.columns) if k and k not in candidate.vanishing]
        low, high = parameters.box
        told = all(self.optimum.sd(j) < TOLD * (high[j] - low[j]) for j in shapes if j in self.optimum.free)
        return told and not np.any(parameters.on_bound(self.optimum.coordinates)[shapes])


@dataclass(frozen=True, eq=False)
class Stand:
    """One model, ``candidates`` by id switched off, and the objective; ``own`` columns of the model itself are free.

    ``open`` opens a simulator of a part of the recordings.
    """

    study: Objective
    candidates: Mapping[str, Candidate]
    own: tuple[int, ...]
    open: OpenSimulator

    def free(self, effects: Collection[str]) -> tuple[int, ...]:
        """Columns of the model itself and of some candidates."""
        return (*self.own, *(j for id_ in effects for j in self.candidates[id_].columns))

    def at(self, values: Mapping[str, float], effects: Collection[str]) -> FloatArray:
        """Search coordinates of values by name with some effects on; what has no value stands where it is off."""
        parameters = self.study.parameters
        on = set(self.free(effects))
        start = [
            values.get(p.name, p.start) if j in on or p.recording is not None else p.start
            for j, p in enumerate(parameters)
        ]
        return parameters.to_search(np.array(start))

    def fit(
        self,
        values: Mapping[str, float],
        effects: Sequence[str],
        noise: Mapping[str, OutputNoise],
        settings: ClimbSettings,
    ) -> Held:
        """Climb from values by name with some effects on."""
        start = self.at(values, effects)
        return Held(self, tuple(effects), climb(self.study, start, self.free(effects), noise=noise, settings=settings))


class Stands:
    """The stands of a loop, built when they are asked for; each set of candidates once."""

    def __init__(self, bench: Workbench, plain: Calibration, own: tuple[int, ...]) -> None:
        self._bench, self._plain, self._own = bench, plain, own
        self._built: dict[frozenset[str], Stand] = {}

    def of(self, ids: Collection[str]) -> Stand:
        """The stand that has these candidates (one that is at hand may have more)."""
        wanted = frozenset(ids)
        ready = [built for built in self._built if wanted == built] or [
            built for built in self._built if self._bench.family.roomy and wanted <= built
        ]
        if ready:
            return self._built[ready[0]]
        offer = self._bench.family.offer(wanted)
        calibration = self._bench.family.on(self._plain, offer.model)
        calibration = replace(calibration, parameters=calibration.parameters.extended(offer.parameters))
        first = len(self._plain.parameters)
        found = {}
        for candidate, count in offer.candidates:
            found[candidate.id] = replace(candidate, columns=tuple(range(first, first + count)))
            first += count
        stand = Stand(self._bench.open_objective(calibration), found, self._own, self._bench.open)
        self._built[wanted] = stand
        return stand

    @property
    def undecided(self) -> list[str]:
        """Parameters that are held until an effect lets the data tell them."""
        return [p.name for p in self._plain.parameters if p.auto]

    def freed(self, name: str) -> Stands:
        """Stands of the same candidates on which a further parameter is free."""
        items = tuple(replace(p, auto=p.auto and p.name != name) for p in self._plain.parameters)
        own = tuple(sorted({*self._own, self._plain.parameters.index(name)}))
        return Stands(self._bench, replace(self._plain, parameters=ParameterSet(items)), own)

    def beside(self, held: ParameterSet) -> Stands:
        """Stands of the same candidates that have further parameters, which stay where they are."""
        parameters = self._plain.parameters.extended(tuple(held))
        return Stands(self._bench, replace(self._plain, parameters=parameters), self._own)

    def read_otherwise(self) -> Stands | None:
        """Stands of the same candidates whose inputs are read the other way between the samples, if that is open."""
        if self._bench.settings.calibration.interpolation != "auto":
            return None
        other = read_otherwise(self._plain)
        return Stands(self._bench, other, self._own) if other is not None else None

    def finer(self, held: Held) -> Stands | None:
        """Stands of the same candidates, solved more finely, if the solver's error shows beside a fit's noise."""
        tight = replace(
            self._plain.solver, relative_tolerance=FINER * self._plain.solver.relative_tolerance,
            absolute_tolerance=FINER * self._plain.solver.absolute_tolerance,
        )  # fmt: skip
        other = Stands(self._bench, replace(self._plain, solver=tight), self._own)
        study, at, noise = other.of(held.stand.candidates).study, held.optimum.coordinates, held.optimum.noise
        (there,) = study.residuals(at[np.newaxis, :])
        if there is not None:
            change = study.whiten(there, None, noise).residual - held.optimum.whitened.residual
            if math.sqrt(float(np.mean(change**2))) > SHOWS:
                return other
        other.forget()
        return None

    def forget(self, *keep: Stand) -> None:
        """Close all stands but some."""
        for key, stand in list(self._built.items()):
            if stand not in keep:
                self._bench.tally.count(stand.study)
                stand.study.simulator.close()
                del self._built[key]
