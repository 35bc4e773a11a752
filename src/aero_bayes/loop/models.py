"""Simulated models of one structure each, and their fits."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import CannotFinishError
from aero_bayes.estimate.calibration import Calibration, for_recordings
from aero_bayes.estimate.delays import delay_columns
from aero_bayes.estimate.local_fit import LocalFitSettings, Optimum, fit_noise
from aero_bayes.estimate.objective import Objective
from aero_bayes.estimate.parameters import Parameter, ParameterSet, prior_curvature
from aero_bayes.estimate.residual_tests import check_residuals
from aero_bayes.loop.held_terms import held_candidate
from aero_bayes.loop.modelica_family import CandidateTerm, ModelicaFamily, OpenSimulator
from aero_bayes.loop.table import Structure
from aero_bayes.simulation.interface import ParameterTarget

#: Distance of a term's size from where the term is off that counts as none, as a share of its largest nominal one.
MIN_SIZE = 1e-9


@dataclass(frozen=True, eq=False)
class CandidateModel:
    """The simulated model of a structure, held against the recordings."""

    objective: Objective
    candidates: Mapping[str, CandidateTerm]
    free_base_columns: tuple[int, ...]

    def free(self, terms: Collection[str]) -> tuple[int, ...]:
        """Columns that are free with some terms on."""
        return (*self.free_base_columns, *(j for id_ in terms for j in self.candidates[id_].columns))

    def coordinates_of(self, values: Mapping[str, float], terms: Collection[str]) -> FloatArray:
        """Search coordinates of SI values by name with some terms on; the others are switched off."""
        items, on = self.objective.parameters.items, set(self.free(terms))
        off = {j for c in self.candidates.values() for j in c.columns} - on
        start = [p.start if j in off else values.get(p.name, p.start) for j, p in enumerate(items)]
        return self.objective.parameters.to_search(np.array(start))


@dataclass(frozen=True, eq=False)
class FittedModel:
    """A structure fitted by least squares: its model, and the optimum there."""

    model: CandidateModel
    terms: Structure
    optimum: Optimum

    @cached_property
    def values(self) -> dict[str, float]:
        """SI values by name; terms that are off have their off values."""
        parameters = self.model.objective.parameters
        return dict(zip(parameters.names, parameters.from_search(self.optimum.coordinates).tolist(), strict=True))

    def term_values(self, id_: str) -> dict[str, float]:
        """SI values of one term's parameters by name."""
        names = self.model.objective.parameters.names
        return {names[j]: self.values[names[j]] for j in self.model.candidates[id_].columns}

    @property
    def noise(self) -> FloatArray:
        """What it leaves of each output (m,): the unit of its whitened residual."""
        return np.array([self.optimum.noise[o].sd for o in self.model.objective.outputs])

    @cached_property
    def response(self) -> LinearResponse:
        """How its free parameters readjust to a change of the outputs, to first order."""
        return LinearResponse.of(self.model.objective, self.optimum)

    @property
    def off_terms(self) -> Structure:
        """Terms whose fitted size is off: the model is the same without them."""
        found = []
        for id_ in self.terms:
            candidate = self.model.candidates[id_]
            if candidate.starts:
                item = self.model.objective.parameters.items[candidate.columns[0]]
                size = max(abs(start[0] - item.start) for start in candidate.starts)
                if abs(self.values[item.name] - item.start) <= MIN_SIZE * size:
                    found.append(id_)
        return tuple(found)

    def at_declared_values(self) -> FittedModel | None:
        """The same with the first model's parameters at their starting values.

        None if that is no other point, or cannot be simulated."""
        objective, optimum, own = self.model.objective, self.optimum, list(self.model.free_base_columns)
        point = optimum.coordinates.copy()
        point[own] = objective.parameters.to_search(objective.parameters.start)[own]
        found = None if np.array_equal(point, optimum.coordinates) else objective.evaluate(point, optimum.free)
        if found is None:
            return None
        white = objective.whiten(found, optimum.noise)
        new = replace(optimum, coordinates=point, evaluation=found, whitened=white, log_likelihood=white.log_likelihood)
        return replace(self, optimum=new)

    def structured(self, floors: Mapping[tuple[str, str], float]) -> tuple[str, ...]:
        """Outputs in which it leaves more than what sensors add."""
        objective, optimum = self.model.objective, self.optimum
        calibration = objective.calibration
        data, outputs = calibration.data, objective.outputs
        moved = {o: 1e-7 * float(data.scale[data.outputs.index(o)]) for o in outputs}
        settings = LocalFitSettings(
            kinds={o: "white" for o in outputs if calibration.noise.kind(o) == "white"},
            floors={o: max(data.floors.get(o, 0.0), moved[o]) for o in outputs},
        )
        noise = fit_noise(objective, optimum.evaluation.residual, settings)
        reports = check_residuals(calibration, objective.series, replace(optimum, noise=noise), floors)
        left = {r.output for r in reports if r.verdict == "structured" and not r.exact}
        return tuple(o for o in outputs if o in left)


@dataclass(frozen=True, eq=False)
class LinearResponse:
    """Gauss-Newton readjustment of free parameters (f,): ``step`` (f, f) is the inverse of their curvature.

    ``remaining`` (N,) is the whitened residual once they have made their own step ``free_step``."""

    slopes: FloatArray
    step: FloatArray
    free_step: FloatArray
    remaining: FloatArray

    @classmethod
    def of(cls, objective: Objective, fit: Optimum) -> LinearResponse:
        """Linearise a fit. Delays stay: the response to them has corners."""
        slopes, residual, free = fit.whitened.slopes, fit.whitened.residual, list(fit.free)
        first, second = (d[free] for d in objective.parameters.prior_derivatives(fit.coordinates))
        delays = delay_columns(objective, free)
        steady = [k for k, j in enumerate(free) if j not in delays]
        own = slopes[steady]
        curvature = own @ own.T + prior_curvature(second[steady])
        # Where parameters cannot be told apart, the smallest step that does, in units of what each is known to.
        unit = 1.0 / np.sqrt(np.diag(curvature))
        both = np.outer(unit, unit)
        step = np.zeros((len(free), len(free)))
        step[np.ix_(steady, steady)] = np.linalg.pinv(curvature * both, 1e-10, hermitian=True) * both
        free_step = step @ (slopes @ residual + first)
        return cls(slopes, step, free_step, residual - free_step @ slopes)

    def readjusted(self, changes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Changes of the outputs (q, N) once the free parameters have readjusted, and how these move back (q, f)."""
        back = (changes @ self.slopes.T) @ self.step
        return changes - back @ self.slopes, back


@dataclass(frozen=True, eq=False)
class ModelSource:
    """Where models of structures come from; ``held`` are values that are held fixed and may be wrong, by their ids."""

    family: ModelicaFamily
    plain: Calibration
    free_base_columns: tuple[int, ...]
    open_objective: Callable[[Calibration], Objective]
    open: OpenSimulator
    held: Mapping[str, Parameter]

    def build(self, terms: Collection[str]) -> CandidateModel:
        """Return the model with some terms and no others, switched off. CannotFinishError if there is none."""
        laws = sorted(t for t in terms if t not in self.held)
        offer = self.family.with_candidates(laws)
        parts = [*offer.terms]
        for id_ in sorted(t for t in terms if t in self.held):
            held = replace(self.held[id_], free_if_identified=False)
            parts.append((held_candidate(id_, held), self.family.starts_on([held], self.plain.model, offer.model)))
        calibration = self.family.transfer(self.plain, offer.model)
        candidates: dict[str, CandidateTerm] = {}
        for candidate, own in parts:
            known = {p.name for p in calibration.parameters}
            new = self._of_recordings([p for p in own if p.name not in known], calibration)
            calibration = replace(calibration, parameters=calibration.parameters.extended(new))
            names = [p.name for p in own if p.name in known] + [p.name for p in new]
            columns = tuple(calibration.parameters.index(name) for name in names)
            candidates[candidate.id] = replace(candidate, columns=columns)
        targets = {p.target.name for p in calibration.parameters if isinstance(p.target, ParameterTarget)}
        fixed = {n: v for n, v in calibration.fixed.items() if n not in targets}
        calibration = replace(calibration, fixed=fixed)
        wanted = {id_: candidates[id_] for id_ in terms if id_ in candidates}
        if len(wanted) < len(set(terms)):
            raise CannotFinishError(f"no model has {', '.join(terms)} together")
        return CandidateModel(self.open_objective(calibration), wanted, self.free_base_columns)

    def _of_recordings(self, own: list[Parameter], calibration: Calibration) -> tuple[Parameter, ...]:
        """Parameters of a term; starts of its states have a value in each recording."""
        if not any(p.starts for p in own):
            return tuple(own)
        return for_recordings(ParameterSet(tuple(own)), calibration.model, calibration.data.recordings).items


class Models:
    """Models by their terms, each built once, and kept open until all are closed."""

    def __init__(self, source: ModelSource) -> None:
        self.source = source
        self._built: dict[Structure, CandidateModel | None] = {}

    def of(self, terms: Collection[str]) -> CandidateModel | None:
        """Return the model of a structure; None where it cannot be built."""
        key = tuple(sorted(terms))
        if key not in self._built:
            try:
                self._built[key] = self.source.build(key)
            except CannotFinishError:
                self._built[key] = None
        return self._built[key]

    def drop(self, terms: Collection[str]) -> None:
        """Close a model."""
        model = self._built.pop(tuple(sorted(terms)), None)
        if model is not None:
            model.objective.simulator.close()

    def close(self) -> None:
        """Close all models."""
        for terms in list(self._built):
            self.drop(terms)
