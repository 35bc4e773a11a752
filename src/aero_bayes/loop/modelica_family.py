"""The family of a Modelica model, which a loop searches: its candidates, and the model with laws added."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from aero_bayes.declared import DeclaredEffect
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.parameters import Parameter, ParameterSet
from aero_bayes.estimate.priors import LogUniform, Normal
from aero_bayes.estimate.simulation_error import sharpened
from aero_bayes.files import ScratchFolder
from aero_bayes.laws.attach import AlgebraicLoopError, LawBlocks, attached, can_be_attached
from aero_bayes.laws.candidates import (
    PlacedLaw,
    is_possible,
    place_law,
    place_laws,
    with_moved_input,
)
from aero_bayes.laws.coupled_fmu import couple
from aero_bayes.laws.law import START_PREFIX
from aero_bayes.laws.law_places import START, LawPlaces, is_held
from aero_bayes.laws.probed_model import (
    CurveBasis,
    ProbedModel,
    built_once,
    curve_basis,
    probed_model,
    state_names,
    states_by_base_name,
)
from aero_bayes.laws.write_model import WrittenModel, write_laws
from aero_bayes.loop.nominal_values import port_nominals
from aero_bayes.modelica.embedded import export_flat
from aero_bayes.modelica.flat import FlatModel
from aero_bayes.modelica.library import declared_members
from aero_bayes.modelica.rumoca_front import load_flat
from aero_bayes.simulation.interface import (
    DelayTarget,
    DiffusionTarget,
    ParameterTarget,
    Problem,
    Simulator,
    StartTarget,
)
from aero_bayes.simulation.model import Model, ModelicaSource

OpenSimulator = Callable[[Problem], Simulator]

#: Prior standard deviation of the magnitude of a law, in nominal values, which come from a first model that may be far
#: off (a growing culture has 50 of them); and of the heights of a curve, which is held small.
MAGNITUDE_PRIOR_FACTOR, CURVE_PRIOR_FACTOR = 100.0, 3.0


#: Starting points of the parameters of a candidate.
Starts = tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class CandidateTerm:
    """A term that the model may lack."""

    id: str
    port: str
    starts: Starts
    columns: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class ModelWithCandidates:
    """A model with candidate terms built in, all switched off, and the parameters of each."""

    model: Model
    terms: Sequence[tuple[CandidateTerm, Sequence[Parameter]]]


@dataclass(frozen=True, eq=False)
class ExtendedModel(WrittenModel):
    """A model with effects, written as Modelica and exported; ``sharper`` is the same with narrower roundings."""

    model: Model
    sharper: Model | None
    parameters: tuple[Parameter, ...]
    names: Mapping[str, tuple[tuple[str, str], ...]]


def calibration_on(calibration: Calibration, model: Model, names: Mapping[str, str]) -> Calibration:
    """Return a calibration with another model. ``names`` gives the names there of states that are named otherwise."""

    def renamed(by_state: Mapping[str, float]) -> dict[str, float]:
        return {names.get(state, state): value for state, value in by_state.items()}

    data = calibration.data.with_experiments(
        replace(e, start=renamed(e.start), start_sd=renamed(e.start_sd)) for e in calibration.data.experiments
    )
    parameters = of_named_states(calibration.parameters, names)
    process = calibration.process
    if process is not None:
        process = replace(process, diffusion=renamed(process.diffusion))
    return replace(calibration, data=data, model=model, process=process, parameters=ParameterSet(parameters))


def of_named_states(parameters: Iterable[Parameter], names: Mapping[str, str]) -> tuple[Parameter, ...]:
    """Return parameters for a model in which some states have other ``names``."""
    found = []
    for p in parameters:
        if isinstance(p.target, StartTarget | DiffusionTarget):
            there = replace(p.target, state=names.get(p.target.state, p.target.state))
            p = replace(p, target=there, starts=tuple(names.get(s, s) for s in p.starts))
        found.append(p)
    return tuple(found)


#: Magnitudes to start from, in nominal values: of a law with further parameters, and of a law with the magnitude only.
#: The latter may act only beyond a threshold, which a coarse grid would step over.
START_MAGNITUDES, START_MAGNITUDES_WITHOUT_SHAPE = (
    (1.0, 0.2, 5.0),
    (1.0, 0.1, 0.3, 0.6, 0.75, 0.8, 0.84, 0.9, 1.2, 1.6, 2.5, 5.0),
)
#: Values of further parameters in nominal values, where their bounds are less than a factor apart.
START_LEVELS, NARROW_BOUND_RATIO = (1.0, 0.85, 0.65, 0.4, 1.1), 30.0


def fitted_parameters(placed: PlacedLaw) -> list[Parameter]:
    """Return the parameters of a placed law with their priors, the magnitude first.

    A prior is normal about zero, or log-uniform where the bounds are positive."""
    found = []
    for p in placed.parameters():
        limits = placed.limits(p)
        low, high = limits.get("min", -1e3 * limits["nominal"]), limits.get("max", 1e3 * limits["nominal"])
        name, default = placed.names[p.name], p.value("default", placed.all_nominals)
        positive = low > 0.0
        factor = CURVE_PRIOR_FACTOR if placed.law.curve_input else MAGNITUDE_PRIOR_FACTOR
        prior = LogUniform(low, high) if positive else Normal(0.0, factor * limits["nominal"])
        target = DelayTarget(placed.moved_input) if placed.moved_input else ParameterTarget(name)
        one = Parameter(
            name, placed.unit(p), default, low, high, prior, "log" if positive else "linear", placed.about(p), target
        )
        if p in placed.law.starts and not placed.moved_input:
            one = replace(one, starts=(f"{placed.instance}.{p.name.removeprefix(START_PREFIX)}",))
        found.append(one)
    return found


def starting_values(placed: PlacedLaw, effect: DeclaredEffect | None = None, highest: float = 1.0) -> Starts:
    """Return starting values of the parameters of a law: each magnitude with the first value of each further one, and
    with the others of one at a time.

    Magnitudes have both signs where the bounds allow it."""
    if placed.law.curve_input:
        return ()
    if effect is not None and (effect.starts or effect.inverse_shares):
        return _declared(placed, effect, highest)
    choices: list[Collection[float]] = []
    parameters = [p for p in placed.parameters() if p not in placed.law.starts]
    for k, p in enumerate(parameters):
        limits = placed.limits(p)
        low, high = limits.get("min", -math.inf), limits.get("max", math.inf)
        scale = limits["nominal"]
        if k == 0:
            static = len(parameters) == 1 and low >= 0.0 and not placed.has_states
            sizes = [
                m * scale
                for m in (START_MAGNITUDES_WITHOUT_SHAPE if static or placed.law.threshold else START_MAGNITUDES)
            ]
            values = [s for s in sizes if s <= high] + ([-s for s in sizes if -s >= low] if low < 0.0 else [])
        elif low > 0.0 and high < NARROW_BOUND_RATIO * low:
            values = [m * scale for m in START_LEVELS if low < m * scale < high]
        elif low > 0.0:
            values = [scale, math.sqrt(scale * low), math.sqrt(scale * high)]
        else:
            values = [scale] if low >= 0.0 else [scale, -scale]
        choices.append(values)
    return tuple((size, *shape) for size in choices[0] for shape in _one_at_a_time(choices[1:]))


def _one_at_a_time(choices: Sequence[Collection[float]]) -> Iterator[tuple[float, ...]]:
    """Yield the first values of all, then each other value of one among the first ones of the rest."""
    first = tuple(next(iter(values)) for values in choices)
    yield first
    for k, values in enumerate(choices):
        yield from ((*first[:k], value, *first[k + 1 :]) for value in values if value != first[k])


def _declared(placed: PlacedLaw, effect: DeclaredEffect, highest: float) -> Starts:
    choices: list[tuple[float, ...]] = []
    parameters = [p for p in placed.parameters() if p not in placed.law.starts]
    for p in parameters:
        limits = placed.limits(p)
        values = effect.starts.get(p.name, (limits["nominal"],))
        if len(parameters) == 1 and limits.get("min", -math.inf) >= 0.0:
            values = (*values, 0.2 * min(values))
        if p.name in effect.inverse_shares:
            values = tuple(1.0 / (share * max(highest, 1e-3)) for share in effect.inverse_shares[p.name])
        choices.append(values)
    return tuple(itertools.product(*choices))


#: Nominal values of the signals at ports, by the ids of the ports.
PortNominals = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True)
class ModelicaFamily:
    """A Modelica model, the base model, and the same model with laws added."""

    places: LawPlaces
    folder: Path
    placed: dict[str, PlacedLaw] = field(default_factory=dict, compare=False, repr=False)
    _starts: dict[str, Starts] = field(default_factory=dict, compare=False, repr=False)
    _written: list[PlacedLaw] = field(default_factory=list, compare=False, repr=False)
    _open: list[ProbedModel] = field(default_factory=list, compare=False, repr=False)

    def base_model(self) -> Model:
        """Return the model without any law added."""
        source = ModelicaSource(self.places.base, self.places.sources, self.places.libraries)
        return replace(self._export(self.places.flat, "plain"), source=source)

    def prepare(self, calibration: Calibration, fit: Optimum, open_simulator: OpenSimulator) -> tuple[str, ...]:
        """Place the laws that are candidates, with nominal values from a fit. Returns their ids."""
        kept = self.places.allowed(self.places.candidates_for(calibration.data))
        nominals = self._nominals(calibration, fit, open_simulator)
        required = self.places.candidate_filter.require
        kept = [
            c for c in kept
            if c.id in required or all(is_possible(c.law, nominals.get(one.port.id, {})) for one in c.parts)
        ]  # fmt: skip
        experiments = calibration.data.experiments
        highest = max((float(np.abs(s.values).max()) for e in experiments for s in e.inputs), default=1.0)
        self.placed.clear()
        self._open.clear()
        recorded = set.intersection(*({s.name for s in e.inputs} for e in experiments))
        laws = place_laws(kept, self.places.taken_names(), nominals, free_starts=True)
        for placed in (with_moved_input(p, recorded) for p in laws):
            declared = self.places.declared.effects.get(placed.id)
            self.placed[placed.id] = placed
            self._starts[placed.id] = starting_values(placed, declared, highest)
        return tuple(self.placed)

    def _nominals(self, calibration: Calibration, fit: Optimum, open_simulator: OpenSimulator) -> PortNominals:
        return port_nominals(self.places.flat, self.places.ports, calibration, fit, open_simulator)

    def refinements(self) -> dict[str, str]:
        """Return, for each law that refines another one at the same port, the id of that one."""
        known = {(p.law.id, p.place): id_ for id_, p in self.placed.items()}
        coarse = {id_: known.get((p.law.refines, p.place)) for id_, p in self.placed.items()}
        return {id_: of for id_, of in coarse.items() if of is not None}

    def curves(self) -> Mapping[str, str]:
        """Return learned curves, and the variable over which each is learned."""
        found = {id_: p for id_, p in self.placed.items() if p.law.curve_input}
        return {id_: str(p.port.signals.get(p.law.curve_input, p.port.id)) for id_, p in found.items()}

    def basis(self, id_: str) -> CurveBasis:
        """Return the basis functions of a learned curve."""
        return curve_basis(self.placed[id_], self.places.law_models)

    def parameters(self, id_: str) -> tuple[Parameter, ...]:
        """Return the parameters of a candidate, by their names in a model with candidates."""
        return tuple(fitted_parameters(self.placed[id_]))

    def starts(self, id_: str) -> Starts:
        """Return starting values of the parameters of a candidate; none for a learned curve."""
        return self._starts.get(id_, ())

    def with_candidates(self, ids: Collection[str]) -> ModelWithCandidates:
        """Return the model with some laws, switched off."""
        placed_laws = self._ordered(ids)
        terms = [
            (CandidateTerm(u.id, self.places.place_name(u), self.starts(u.id)), self.parameters(u.id))
            for u in placed_laws
            if not u.is_twin
        ]
        return ModelWithCandidates(self._simulated(placed_laws), terms)

    @cached_property
    def blocks(self) -> LawBlocks:
        return LawBlocks(self.places.law_models, self.folder)

    def _opened(self) -> ProbedModel:
        """Return the model with its ports open for all laws that are placed and can be attached."""
        if not self._open:
            placed_laws = [p for p in self.placed.values() if can_be_attached(p)]
            export = partial(self._export, what="open")
            self._open.append(probed_model(self.base_model(), placed_laws, self.places.flat, export))
        return self._open[0]

    def _attached(self, placed_laws: Sequence[PlacedLaw]) -> Model:
        """Return the model with laws attached. Raises AlgebraicLoopError where they have to be compiled with it."""
        if not all(map(can_be_attached, placed_laws)):
            raise AlgebraicLoopError
        base = self._opened()
        given = [(u.id, u.instance, u.names, u.all_nominals) for u in placed_laws]
        of = f"{base.model.sha256}{given}"
        return built_once(
            self.folder, f"{self.places.title}-attached", of,
            lambda out: couple(attached(base, placed_laws, self.blocks), out),
        )  # fmt: skip

    def _simulated(self, placed_laws: Sequence[PlacedLaw]) -> Model:
        """Return the model with those laws whose equations are solved."""
        solved = [placed for placed in placed_laws if not placed.moved_input]
        return self._with(solved) if solved else self.base_model()

    def _with(self, placed_laws: Sequence[PlacedLaw]) -> Model:
        with suppress(AlgebraicLoopError):
            return self._attached(placed_laws)
        return self._export(self._compiled_together(placed_laws), "candidates")

    def _compiled_together(self, placed_laws: Sequence[PlacedLaw]) -> FlatModel:
        """Return the flat model of the written model, in which each law is a component."""
        if not placed_laws:
            return self.places.flat
        sources, libraries = self.places.sources, self.places.libraries
        with ScratchFolder() as folder:
            written = write_laws(sources, self.places.base, self.places.flat, placed_laws, folder, max_formula_length=0)
            return load_flat(written.name, (*sources, written.path), libraries)

    def _sharper(self, placed_laws: Sequence[PlacedLaw], model: Model) -> Model | None:
        """Return the simulated model with narrower roundings; None where it has none that are constants."""
        flat = self._compiled_together([placed for placed in placed_laws if not placed.moved_input])
        narrow = sharpened(flat, [v.name for v in model.parameters])
        return self._export(narrow, "sharper") if narrow is not None else None

    def _ordered(self, ids: Iterable[str]) -> list[PlacedLaw]:
        """Return placed laws, and their twins, in the order in which they act.

        It is that of the candidates, whatever the order of ``ids``: of two laws at one signal the first is the inner
        one. Laws that need the derivative of a reading come first."""
        places = {id_: k for k, id_ in enumerate(self.placed)}
        found = [self.placed[id_] for id_ in sorted(ids, key=places.__getitem__)]
        return [part for placed in sorted(found, key=lambda u: not u.law.needs_derivative) for part in placed.parts]

    def extend(self, ids: Sequence[str], values: Mapping[str, float], folder: Path) -> ExtendedModel:
        """Return the model with chosen laws, written as Modelica and exported.

        The text has all of them, as any tool can run it; what is simulated has no equations of a delay that moves a
        recorded input."""
        taken = self.places.taken_names()
        placed_laws: list[PlacedLaw] = []
        names: dict[str, tuple[tuple[str, str], ...]] = {}
        for old in (u for u in self._ordered(ids) if not u.is_twin):
            known = {p.name: values[old.names[p.name]] for p in old.parameters() if old.names[p.name] in values}
            own = {name: float(f"{value:.6g}") for name, value in known.items()}
            placed = place_law(old, taken, nominals=old.nominals, values=own, with_starts=True)
            taken |= {*(one.instance for one in placed.parts), *placed.names.values()}
            placed_laws += replace(placed, moved_input=old.moved_input).parts
            names[old.id] = tuple((old.names[p.name], placed.names[p.name]) for p in old.parameters())
        self._written.extend(placed_laws)
        written, model = self._write(placed_laws, values, folder)
        if any(placed.moved_input for placed in placed_laws):
            model = self._simulated(placed_laws)
        sharper = self._sharper(placed_laws, model)
        firsts = [placed for placed in placed_laws if not placed.is_twin]
        parameters = tuple(p for placed in firsts for p in fitted_parameters(placed))
        return ExtendedModel(**vars(written), model=model, sharper=sharper, parameters=parameters, names=names)

    def with_fitted(
        self, written: ExtendedModel, values: Mapping[str, float], added: Sequence[Parameter]
    ) -> ExtendedModel:
        """Return the written model with fitted values of what was ``added``, starts of its own states among it.

        What has a value in each recording is left as it is."""
        known = [p for p in added if p.name in values]
        starts = {state: values[p.name] for p in known for state in p.starts}
        return written.with_values({p.name: values[p.name] for p in known}, starts)

    def _write(
        self, placed_laws: Sequence[PlacedLaw], values: Mapping[str, float], folder: Path
    ) -> tuple[WrittenModel, Model]:
        """Return the written model and its FMU. ``values`` of the fit go by the names of the model with candidates."""
        written = write_laws(self.places.sources, self.places.base, self.places.flat, placed_laws, folder)
        flat = load_flat(written.name, (*self.places.sources, written.path), self.places.libraries)
        return written, self._export(flat, written.name)

    def transfer(self, calibration: Calibration, model: Model) -> Calibration:
        """Return the calibration of the base model, for a member of the family. States get their names there."""
        return calibration_on(calibration, model, self._states_there(calibration.model, model))

    def starts_on(self, held: Iterable[Parameter], base: Model, model: Model) -> tuple[Parameter, ...]:
        """Return starts that the base model holds, for a member of the family; other parameters as they are."""
        return of_named_states(held, self._states_there(base, model))

    def _states_there(self, base: Model, model: Model) -> Mapping[str, str]:
        """Return names in another model of states of a base model."""
        # the output on which a law acts is known by what the law reads in its place
        every = (part for placed in (*self.placed.values(), *self._written) for part in placed.parts)
        acting = [p for p in every if p.port.attachment == "output"]
        read = {f"{p.instance}.u": p.port.signals["u"].first for p in acting}
        there = states_by_base_name(model, self.places.structure, base.state_aliases, read)
        return state_names(base, self.places.structure, there)

    def describe(self, id_: str) -> str:
        """Return a phrase about a term: a law and its port, or a value or a start that was held."""
        if is_held(id_):
            what = "start" if id_.startswith(START) else "value"
            return f"another {what} of {id_.partition('@')[2]} than the fixed one"
        return self.places.describe(self.placed[id_])

    def _export(self, flat: FlatModel, what: str) -> Model:
        """Return the FMU of a flat model. The hash of the flat model is part of the file name."""

        def build(out: Path) -> None:
            export_flat(flat, out, members=declared_members(self.places.base, self.places.sources))

        return built_once(self.folder, f"{self.places.title}-{what}", repr(flat), build)
