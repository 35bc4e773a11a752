"""Fitted models of one structure each, and the simulated models on which they are fitted."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.interpolation import with_other_interpolation
from aero_bayes.estimate.local_fit import LocalFitSettings, Optimum, local_fit
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.parameters import ParameterSet
from aero_bayes.estimate.progressive_horizon import OpenSimulator
from aero_bayes.laws.model_family import CandidateTerm, ModelFamily
from aero_bayes.search.response import LinearResponse
from aero_bayes.search.structure import Structure
from aero_bayes.sensors.noise import OutputNoise

#: Distance of a term's magnitude from where the term is off that counts as none, as a share of its largest nominal one.
MIN_MAGNITUDE = 1e-9


@dataclass(frozen=True)
class FitNoise:
    """The noise under which structures are fitted and compared."""

    outputs: Mapping[str, OutputNoise]
    temperature: float = 1.0


@dataclass(frozen=True, eq=False)
class CandidateModel:
    """One simulated model that has candidate terms built in, switched off, held against the recordings."""

    objective: Objective
    candidates: Mapping[str, CandidateTerm]
    free_base_columns: tuple[int, ...]
    open: OpenSimulator

    def free(self, terms: Collection[str]) -> tuple[int, ...]:
        """Columns that are free with some terms on."""
        return (*self.free_base_columns, *(j for id_ in terms for j in self.candidates[id_].columns))

    def coordinates_of(self, values: Mapping[str, float], terms: Collection[str]) -> FloatArray:
        """Search coordinates of SI values by name with some terms on; the others are switched off."""
        parameters = self.objective.parameters
        on = set(self.free(terms))
        start = [
            values.get(p.name, p.start) if j in on or p.recording is not None else p.start
            for j, p in enumerate(parameters)
        ]
        return parameters.to_search(np.array(start))

    def fit(self, structure: Structure, start: FloatArray, noise: FitNoise, settings: LocalFitSettings) -> FittedModel:
        """Local fit of a structure from search coordinates."""
        end = local_fit(self.objective, start, self.free(structure.terms), noise=noise.outputs, settings=settings)
        return FittedModel(self, structure, end, noise.temperature)


@dataclass(frozen=True, eq=False)
class FittedModel:
    """A structure fitted to the recordings: the model on which it was fitted, and the optimum there.

    Its log-likelihood counts to the power ``1 / temperature``.
    """

    model: CandidateModel
    structure: Structure
    optimum: Optimum
    temperature: float = 1.0

    @property
    def terms(self) -> tuple[str, ...]:
        return self.structure.terms

    @property
    def readings(self) -> int:
        """Readings that it was fitted to."""
        return self.optimum.whitened.readings

    @property
    def noise(self) -> FitNoise:
        """Under which it was fitted and is compared."""
        return FitNoise(self.optimum.noise, self.temperature)

    @property
    def log_posterior(self) -> float:
        """Of its optimum, but for a constant."""
        return self.optimum.log_likelihood + self.optimum.log_prior

    @cached_property
    def log_evidence(self) -> float:
        """In Laplace's approximation, each reading counted as a share of an independent one."""
        return self.optimum.laplace(self.model.objective.parameters, self.temperature)[1]

    @cached_property
    def values(self) -> dict[str, float]:
        """SI values by name; terms that are off have their off values."""
        parameters = self.model.objective.parameters
        return dict(zip(parameters.names, parameters.from_search(self.optimum.coordinates).tolist(), strict=True))

    @cached_property
    def response(self) -> LinearResponse:
        """How the free parameters readjust to a change of the outputs, to first order."""
        return LinearResponse(self.model.objective, self.optimum)

    @cached_property
    def at_declared_values(self) -> FittedModel | None:
        """The same with the first model's parameters at their starting values; None where they are there already, or
        where that cannot be simulated."""
        objective, optimum, own = self.model.objective, self.optimum, list(self.model.free_base_columns)
        point = optimum.coordinates.copy()
        point[own] = objective.parameters.to_search(objective.parameters.start)[own]
        evaluation = None if np.array_equal(point, optimum.coordinates) else objective.evaluate(point, optimum.free)
        if evaluation is None:
            return None
        white = objective.whiten(evaluation, optimum.noise)
        there = replace(
            optimum, coordinates=point, evaluation=evaluation, whitened=white, log_likelihood=white.log_likelihood
        )
        return replace(self, optimum=there)

    def prepare(self) -> None:
        """Compute what all candidates beside this fit need, once and not in each worker process."""
        _ = self.response
        if not self.terms:
            _ = self.at_declared_values

    @property
    def off_terms(self) -> tuple[str, ...]:
        """Terms whose fitted magnitude is off: the model is the same without them."""
        found = []
        for id_ in self.terms:
            candidate = self.model.candidates[id_]
            if candidate.starts:
                item = self.model.objective.parameters.items[candidate.columns[0]]
                size = max(abs(start[0] - item.start) for start in candidate.starts)
                if abs(self.values[item.name] - item.start) <= MIN_MAGNITUDE * size:
                    found.append(id_)
        return tuple(found)

    def with_noise(self, noise: FitNoise) -> FittedModel:
        """Return the same fit under another noise, without a simulation."""
        optimum = self.optimum
        if any(optimum.noise[o] != n for o, n in noise.outputs.items()):
            optimum = optimum.with_noise(self.model.objective, noise.outputs)
        elif noise.temperature == self.temperature:
            return self
        return replace(self, optimum=optimum, temperature=noise.temperature)

    def refitted(self, noise: FitNoise, settings: LocalFitSettings) -> FittedModel:
        """Return the optimum under another noise, from here."""
        return self.model.fit(self.structure, self.optimum.coordinates, noise, settings)

    def term_values(self, id_: str) -> dict[str, float]:
        """SI values of one term's parameters by name."""
        names = self.model.objective.parameters.names
        return {names[j]: self.values[names[j]] for j in self.model.candidates[id_].columns}

    def squares_left(self) -> dict[str, float]:
        """Return the mean square of the whitened residual by output."""
        series, white = self.model.objective.series, self.optimum.whitened.residual
        ends = np.cumsum([one.sampling.size for one in series])[:-1]
        parts: dict[str, list[FloatArray]] = {}
        for one, residual in zip(series, np.split(white, ends), strict=True):
            parts.setdefault(one.output, []).append(residual)
        return {output: float(np.mean(np.concatenate(p) ** 2)) for output, p in parts.items()}


@dataclass(frozen=True, eq=False)
class ModelSource:
    """Where candidate models come from."""

    family: ModelFamily
    plain: Calibration
    free_base_columns: tuple[int, ...]
    open_objective: Callable[[Calibration], Objective]
    open: OpenSimulator
    interpolation_is_free: bool


class ModelCache:
    """Candidate models by structure setting and terms, each built once."""

    def __init__(self, source: ModelSource) -> None:
        self.source = source
        self._built: dict[tuple[Structure, frozenset[str]], CandidateModel] = {}

    def of(self, structure: Structure, extra: Collection[str] = ()) -> CandidateModel:
        """Return the model for a structure, with ``extra`` candidate terms built in."""
        setting, wanted = structure.minus(*structure.terms), frozenset((*structure.terms, *extra))
        extra_terms_are_free = self.source.family.extra_terms_are_free
        for (other, ids), built in self._built.items():
            if other == setting and (ids == wanted or (extra_terms_are_free and wanted <= ids)):
                return built
        model = self._build(setting, wanted)
        self._built[setting, wanted] = model
        return model

    def _build(self, setting: Structure, wanted: frozenset[str]) -> CandidateModel:
        plain, own = with_setting(self.source.plain, self.source.free_base_columns, setting)
        offer = self.source.family.with_candidates(wanted)
        calibration = self.source.family.transfer(plain, offer.model)
        calibration = replace(calibration, parameters=calibration.parameters.extended(offer.parameters))
        first = len(plain.parameters)
        found = {}
        for candidate, count in offer.candidates:
            found[candidate.id] = replace(candidate, columns=tuple(range(first, first + count)))
            first += count
        return CandidateModel(self.source.open_objective(calibration), found, own, self.source.open)

    @property
    def free_later(self) -> tuple[str, ...]:
        """Parameters that are fixed until the search frees them."""
        return tuple(p.name for p in self.source.plain.parameters if p.free_if_identified)

    @property
    def interpolation_is_free(self) -> bool:
        """Whether the search may change the interpolation of the inputs."""
        return self.source.interpolation_is_free and with_other_interpolation(self.source.plain) is not None

    @property
    def ports(self) -> dict[str, str]:
        """The port of each term that was built in."""
        return {id_: c.port for model in self._built.values() for id_, c in model.candidates.items()}

    def on_beginning(self, share: float) -> ModelCache:
        """Return the same models on the first ``share`` of each recording."""
        plain = self.source.plain
        return ModelCache(replace(self.source, plain=replace(plain, data=plain.data.beginning(share))))

    def close(self, count: Callable[[Objective], None] = lambda objective: None) -> None:
        """Close all simulators; ``count`` is told each objective."""
        for model in self._built.values():
            count(model.objective)
            model.objective.simulator.close()
        self._built.clear()


def with_setting(plain: Calibration, own: tuple[int, ...], structure: Structure) -> tuple[Calibration, tuple[int, ...]]:
    """The first model's calibration with the parameters freed and the inputs read as a structure says, and the columns
    that are free."""
    if structure.other_interpolation:
        other = with_other_interpolation(plain)
        if other is None:
            raise CannotFinishError("the inputs have no other interpolation between their samples")
        plain = other
    if structure.freed:
        items = tuple(
            replace(p, free_if_identified=p.free_if_identified and p.name not in structure.freed)
            for p in plain.parameters
        )
        plain = replace(plain, parameters=ParameterSet(items))
        own = tuple(sorted({*own, *(plain.parameters.index(name) for name in structure.freed)}))
    return plain, own
