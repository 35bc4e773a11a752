"""The family of a Modelica model: the model with laws at its ports and in its replaceable models."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from aero_bayes.declared import PackageDeclaration
from aero_bayes.errors import InputError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.declared import declared_overrides
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.parameters import Override, Parameter
from aero_bayes.export.embedded import export_flat
from aero_bayes.export.flat import FlatModel
from aero_bayes.export.library import declaration_of, declared_members
from aero_bayes.export.rumoca_front import load_flat
from aero_bayes.language.sources import Sources
from aero_bayes.laws.candidate_filter import CandidateFilter
from aero_bayes.laws.candidate_groups import candidate_groups, refinements
from aero_bayes.laws.candidates import (
    Candidate,
    declared_candidates,
    find_candidates,
    is_possible,
    ports_with_laws,
    with_applicable_laws,
)
from aero_bayes.laws.compose import LawModels, compose_laws, law_models
from aero_bayes.laws.formula import DISTURBANCE, FORMULA, Formula, disturbances, formula_law, formula_starts, told
from aero_bayes.laws.formula_places import STATE_AND_TERM, FormulaPort, formula_ports, near_signals, parameter_ports
from aero_bayes.laws.law import Law, read_laws, shipped_laws
from aero_bayes.laws.learned_curve import curve_basis, curve_variable, isolated_curve, with_curve_inputs
from aero_bayes.laws.model_family import (
    CandidateTerm,
    CurveBasis,
    DisturbedModel,
    ExtendedModel,
    FormulaPlace,
    ModelWithCandidates,
    OpenSimulator,
    ProposedFormula,
    calibration_on,
    to_significant_digits,
)
from aero_bayes.laws.model_sources import read_sources, reserved_names
from aero_bayes.laws.placed_law import (
    PlacedLaw,
    at_same_ports,
    describe_law,
    place_law,
    place_laws,
    with_moved_input,
)
from aero_bayes.laws.redeclare import can_be_combined, load_with_redeclarations, split_by_replaceable
from aero_bayes.laws.replaceable_laws import laws_for_constraint
from aero_bayes.laws.starting_values import fitted_parameters, starting_values
from aero_bayes.laws.state_names import state_aliases, state_names, states_by_base_name
from aero_bayes.laws.write_model import WrittenModel, can_be_written, write_laws
from aero_bayes.ports import (
    AliasStructure,
    Port,
    ReplaceableModel,
    alias_structure,
    find_replaceable_models,
    port_nominals,
    replaceable_ports,
    signal_nominal,
    simulated_signals,
)
from aero_bayes.simulation.model import Model, ModelicaSource

#: Models that are fitted a few times and dropped: compiling them quickly saves more than their slower runs cost.
_TRIED = ("candidates", "curves")
#: Nominal values of the signals at ports, by the ids of the ports.
PortNominals = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True)
class ModelicaFamily:
    """A Modelica model, the base model, and the same model with laws added.

    Parameters
    ----------
    base : str
        Name of the Modelica class.
    sources : tuple of Path
        Files and package folders from which it is loaded. Laws in them are candidates, as the shipped ones are.
    folder : Path
        Where FMUs are kept.
    libraries : tuple of Path
        Folders that hold packages which the model uses.
    candidate_filter : CandidateFilter
        The candidates that the user allows.
    """

    base: str
    sources: tuple[Path, ...]
    folder: Path
    libraries: tuple[Path, ...] = ()
    candidate_filter: CandidateFilter = field(default_factory=CandidateFilter)
    _placed: dict[str, PlacedLaw] = field(default_factory=dict, compare=False, repr=False)
    _read: dict[str, str] = field(default_factory=dict, compare=False, repr=False)
    _starts: dict[str, tuple[tuple[float, ...], ...]] = field(default_factory=dict, compare=False, repr=False)
    _formulas: dict[str, Formula] = field(default_factory=dict, compare=False, repr=False)
    _formula_ports: dict[str, FormulaPort] = field(default_factory=dict, compare=False, repr=False)
    _formula_models: dict[tuple[str, str], FlatModel] = field(default_factory=dict, compare=False, repr=False)
    _curve_nominals_pending: list[Callable[[], Mapping[str, float]]] = field(
        default_factory=list, compare=False, repr=False
    )

    @property
    def title(self) -> str:
        return self.base.rpartition(".")[2]

    @cached_property
    def flat(self) -> FlatModel:
        return load_flat(self.base, self.sources, self.libraries)

    @cached_property
    def laws(self) -> tuple[Law, ...]:
        """The shipped laws, and those in the user's sources."""
        return (*shipped_laws(), *read_laws(self.sources))

    @cached_property
    def declared(self) -> PackageDeclaration:
        """What the package of the model declares about it."""
        return declaration_of(self.base, self.sources)

    @cached_property
    def _sources(self) -> Sources:
        return read_sources(self.sources, self.flat)

    @cached_property
    def _replaceable_models(self) -> tuple[ReplaceableModel, ...]:
        return find_replaceable_models(self._sources, self.base)

    @cached_property
    def replaceable_laws(self) -> tuple[Law, ...]:
        """Laws that can take the place of its replaceable models."""
        constraints = dict.fromkeys(one.constraint for one in self._replaceable_models)
        return tuple(law for constraint in constraints for law in laws_for_constraint(self._sources, constraint))

    @cached_property
    def replaceables(self) -> tuple[Port, ...]:
        """Ports at its replaceable models, where there are laws for them."""
        usable = {law.constraint for law in self.replaceable_laws}
        found = [one for one in self._replaceable_models if one.constraint in usable]
        return with_applicable_laws(replaceable_ports(found, self.declared.ports), self.replaceable_laws)

    @cached_property
    def ports(self) -> tuple[Port, ...]:
        """All places where a law may act."""
        found = ports_with_laws(self.flat, self.laws)
        taken = {p.id for p in found}
        return (*found, *(replace(p, id=f"model_{p.id}") if p.id in taken else p for p in self.replaceables))

    @cached_property
    def candidates(self) -> tuple[Candidate, ...]:
        """Every applicable law at every port. If the package names effects, only these and learned curves."""
        found = find_candidates(self.ports, (*self.laws, *self.replaceable_laws))
        return declared_candidates(found, self.declared) if self.declared.effects else found

    @cached_property
    def law_models(self) -> LawModels:
        return law_models(self.laws)

    def base_model(self) -> Model:
        """Return the model without any law added."""
        source = ModelicaSource(self.base, self.sources, self.libraries)
        return replace(self._export(self.flat, "plain"), source=source)

    def overrides(self, model: Model) -> Mapping[str, Override]:
        """Return the declared priors."""
        return declared_overrides(model)

    @property
    def extra_terms_are_free(self) -> bool:
        """Whether one model can have all candidates at once, because all of them are replaceable models."""
        return all(can_be_combined(placed) for placed in self._placed.values())

    def check(self) -> None:
        """Raise InputError if the candidate filter names something unknown, or rejects all candidates."""
        laws = (
            {c.law.id: None for c in self.candidates}
            | {law.id: None for law in self.laws if not self.declared.effects}
            | {FORMULA: None}
        )
        ports = {self.port_name(c.port): None for c in self.candidates} | {p.id: None for p in self.ports}
        self.candidate_filter.check([c.id for c in self.candidates], list(laws), list(ports))
        self._kept(self.candidates)

    def _kept(self, found: Sequence[Candidate]) -> list[Candidate]:
        kept = [c for c in found if self.candidate_filter.accepts(c.id, c.law.id, self.port_name(c.port))]
        if not kept:
            left = "[loop] effects, exclude, ports and laws leave none"
            raise InputError(f"{self.base}: no law is left to try; {left}")
        return kept

    def port_name(self, port: Port) -> str:
        """Return the declared name of a port, which several ports may share; else its id."""
        return self.declared.ports.get(port.id, port.id)

    def prepare(self, calibration: Calibration, fit: Optimum, open_simulator: OpenSimulator) -> tuple[str, ...]:
        """Place the laws that are candidates, with nominal values from a fit. Returns their ids."""
        kept = self._kept(self._candidates(calibration))
        found = any(c.port.replaceable is None for c in kept)
        nominals = self._nominals(calibration, fit, open_simulator) if found else {}
        required = self.candidate_filter.require
        kept = [c for c in kept if c.id in required or is_possible(c.law, nominals.get(c.port.id, {}))]
        highest = max((float(np.abs(s.values).max()) for e in calibration.experiments for s in e.inputs), default=1.0)
        self._placed.clear()
        self._formulas.clear()
        recorded = set.intersection(*({s.name for s in e.inputs} for e in calibration.experiments))
        for placed in (with_moved_input(p, recorded) for p in place_laws(kept, self._taken(), nominals)):
            self._placed[placed.id] = placed
            self._starts[placed.id] = starting_values(placed, self.declared.effects.get(placed.id), highest)
            self._read.update(_read_by(placed))
        self._curve_nominals_pending[:] = [partial(self._curve_nominals, calibration, fit, open_simulator)]
        return tuple(self._placed)

    def _candidates(self, calibration: Calibration) -> Sequence[Candidate]:
        return self.writable_candidates()

    def writable_candidates(self) -> tuple[Candidate, ...]:
        """Return the candidates that can be written into the source."""
        every = self.candidates
        edited = {c.port.id: c for c in every if c.port.attachment in ("equation", "signal")}.values()
        laws = [place_law(c.law, c.port, self._taken(), nominals={}, neighbour=c.neighbour) for c in edited]
        barred = {p.port.id for p in laws if not can_be_written(self.sources, self.base, self.flat, p)}
        return tuple(c for c in every if c.port.id not in barred)

    def _nominals(self, calibration: Calibration, fit: Optimum, open_simulator: OpenSimulator) -> PortNominals:
        return port_nominals(self.flat, self.ports, calibration, fit, open_simulator)

    def _taken(self) -> set[str]:
        """Return names that the model uses already."""
        return reserved_names(self.flat, self.sources)

    def formula_places(self, free: Collection[str]) -> tuple[FormulaPlace, ...]:
        """Return places at which formulas may act: ports, and those of some free parameters that may be functions."""
        found = [p for p in (*formula_ports(self._placed.values()), *self._parameter_ports(free)) if self._wanted(p)]
        self._formula_ports.clear()
        self._formula_ports.update({p.port.id: p for p in found})
        known = self.formula_signals()
        states = [known[s.name][0] for s in self.base_model().states if s.name in known]
        inputs = [known[v.name][0] for v in self.base_model().inputs if v.name in known]
        places = []
        for p in found:
            own = self._own_signal(p)
            near = near_signals(p, [s for s in (own, *self._read_at(p)) if s], states, inputs)
            places.append(FormulaPlace(p.port.id, near, own, p.port.id if p.parameter else "", p.order))
        return tuple(places)

    def _wanted(self, place: FormulaPort) -> bool:
        id_ = place.port.id
        return self.candidate_filter.accepts(f"{FORMULA}@{id_}", FORMULA, self.port_name(place.port))

    def _parameter_ports(self, free: Collection[str]) -> Iterator[FormulaPort]:
        """Yield parameters that may be functions, and whose uses can be written."""
        for place in parameter_ports(self.flat, free):
            placed = place_law(disturbances()[True], place.port, self._taken())
            if can_be_written(self.sources, self.base, self.flat, placed):
                yield place

    def _own_signal(self, place: FormulaPort) -> str:
        """Return the state of a balance, or the signal at an input or output; empty for a parameter."""
        port = place.port
        if place.at_signal:
            return "" if place.parameter else self._named(port.signals["u"])
        return port.balance.state if port.balance is not None else ""

    def _named(self, variable: str) -> str:
        """Return the variable as others call it that are equal to it."""
        same, sign = self._structure.same.get(variable, (variable, 1))
        return same if sign > 0 else variable

    def _read_at(self, place: FormulaPort) -> list[str]:
        """Further signals that a law at the port reads."""
        return [self._structure.of(s) for s in place.port.signals.values() if s in self._structure.same]

    def formula_signals(self) -> Mapping[str, tuple[str, str]]:
        """Return, for each state, input and output of the base model that formulas read: the variable, and its unit."""
        model, structure = self.base_model(), self._structure
        every = (*(v for v in model.outputs if v.kind == "real"), *model.states)
        names = {v.name: self._named(v.name) for v in every if v.name in structure.same}
        names |= {v.name: v.name for v in model.inputs}
        units = {v.name: v.unit for v in (*every, *model.inputs)}
        return {own: (there, units[own] or structure.units.get(there, "")) for own, there in names.items()}

    def state_sizes(self) -> Mapping[str, float]:
        """Return typical sizes of states of the base model that have a balance."""
        there = {self._structure.of(s.name): s.name for s in self.base_model().states if s.name in self._structure.same}
        found = dict[str, float]()
        for p in self._placed.values():
            state = p.port.balance.state if p.port.balance is not None else ""
            if p.port.kind in STATE_AND_TERM and state in there:
                found.setdefault(there[state], p.nominals.get(STATE_AND_TERM[p.port.kind][0], 1.0))
        return found

    def with_unknown_signals(self, calibration: Calibration, places: Sequence[FormulaPlace]) -> DisturbedModel:
        """Return the base model with an unknown signal at each place."""
        taken, placed_laws = self._taken(), list[PlacedLaw]()
        for place in places:
            p = self._formula_ports[place.port]
            placed_laws.append(place_law(disturbances()[p.at_signal], p.port, taken, neighbour=p.neighbour))
            taken = {*taken, placed_laws[-1].instance}
            self._read.update(_read_by(placed_laws[-1]))
        self._formula_models.update(law_models([*disturbances().values()]))
        model = self._with(placed_laws)
        signals = {p.port.id: f"{p.instance}.{DISTURBANCE}" for p in placed_laws}
        states = {**{s.name: s.name for s in self.base_model().states}, **self._states_there(calibration, model)}
        return DisturbedModel(self.transfer(calibration, model), states, signals)

    def add_formulas(self, proposed: Sequence[ProposedFormula]) -> Mapping[str, Mapping[str, float]]:
        """Place formulas as further candidates. Returns their ids, with values of all parameters to start from."""
        taken = self._taken() | {n for p in self._placed.values() for n in (p.instance, *p.names.values())}
        added: list[PlacedLaw] = []
        for number, one in enumerate(proposed, 1):
            here, id_ = self._formula_ports[one.port], FORMULA if number == 1 else f"{FORMULA}_{number}"
            law, port = formula_law(one.formula, here.port, id_, one.largest, self._own_signal(here))
            local = {given: name for name, given in port.signals.items() if name != "u"}
            sizes = {f"{local.get(s.name, 'u')}_n": s.size for s in one.formula.signals}
            nominals = {"q_n": here.size} | sizes
            added.append(place_law(law, port, taken, nominals=nominals, neighbour=here.neighbour))
            taken |= {added[-1].instance, *added[-1].names.values()}
            self._formulas[added[-1].id] = one.formula
        self._formula_models.update(law_models([p.law for p in added]) if added else {})
        for placed in added:
            self._placed[placed.id] = placed
            self._starts[placed.id] = formula_starts(placed)
            self._read.update(_read_by(placed))
        return {
            p.id: {**one.values, **dict(zip(p.names.values(), (one.coefficient, *one.formula.constants), strict=True))}
            for p, one in zip(added, proposed, strict=True)
        }

    def formula_text(self, id_: str, values: Mapping[str, float]) -> str:
        """Return a formula with its sign and numbers; empty for a listed law."""
        if id_ not in self._formulas:
            return ""
        placed = self._placed[id_]
        k, *constant = (values[name] for name in placed.names.values())
        return told(self._formulas[id_], k, *constant[:1], parameter=placed.port.id)

    def formula_ranges(self, id_: str) -> Mapping[str, tuple[float, float]]:
        """Return the range over which each signal of a formula was seen; empty for a listed law."""
        return {s.name: (s.low, s.high) for s in self._formulas[id_].signals} if id_ in self._formulas else {}

    @cached_property
    def _structure(self) -> AliasStructure:
        return alias_structure(self.flat)

    def candidate_groups(self) -> tuple[tuple[str, ...], ...]:
        """Return ids of candidates that are best tried on one model together."""
        return candidate_groups(self._placed)

    def refinements(self) -> Mapping[str, str]:
        """Return, for each law that refines another one at the same port, that one."""
        return refinements(self._placed)

    def curves(self) -> Mapping[str, str]:
        """Learned curves, and the variable over which each is learned."""
        return {id_: curve_variable(placed) for id_, placed in self._placed.items() if placed.law.curve_input}

    def basis(self, id_: str) -> CurveBasis:
        """Return the basis functions of a learned curve."""
        (placed,) = self._sized([id_])
        if placed.port.replaceable is None:
            return curve_basis(placed, self.law_models)
        return curve_basis(*isolated_curve(self._redeclared([placed]), placed))

    def parameters(self, id_: str) -> tuple[Parameter, ...]:
        """Return the parameters of a candidate, by their names in a model with candidates."""
        return tuple(fitted_parameters(self._placed[id_]))

    def starts(self, id_: str) -> tuple[tuple[float, ...], ...]:
        """Starting values of the parameters of a candidate; none for a learned curve."""
        return self._starts[id_]

    def with_candidates(self, ids: Collection[str]) -> ModelWithCandidates:
        """Return the model with some laws switched off, and with all that can be combined in its replaceable models."""
        curves = self.curves()
        inside = any(self._placed[id_].port.replaceable is not None for id_ in ids)
        also = {id_ for id_, placed in self._placed.items() if can_be_combined(placed) and id_ not in curves}
        placed_laws = self._ordered(id_ for id_ in self._placed if id_ in ids or (inside and id_ in also))
        model = self._simulated(placed_laws)
        own = [
            (CandidateTerm(u.id, self.port_name(u.port), self.starts(u.id)), self.parameters(u.id)) for u in placed_laws
        ]
        return ModelWithCandidates(model, tuple(p for _, ps in own for p in ps), tuple((c, len(ps)) for c, ps in own))

    def _simulated(self, placed_laws: Sequence[PlacedLaw]) -> Model:
        """Return the model with those laws whose equations are solved."""
        solved = [placed for placed in placed_laws if not placed.moved_input]
        return self._with(solved) if solved else self.base_model()

    def _with(self, placed_laws: Sequence[PlacedLaw]) -> Model:
        inside, others = split_by_replaceable(placed_laws)
        flat = self._redeclared(inside)
        if others:
            if inside:
                others = at_same_ports(others, ports_with_laws(flat, self.laws))
            flat = compose_laws(flat, others, {**self.law_models, **self._formula_models})
        return self._export(flat, "candidates")

    def _redeclared(self, placed_laws: Sequence[PlacedLaw]) -> FlatModel:
        """Return the model with laws in its replaceable models."""
        if not placed_laws:
            return self.flat
        return load_with_redeclarations(
            self.base, f"{self.title}_candidates", placed_laws, self.sources, self.libraries
        )

    def _sized(self, ids: Iterable[str]) -> list[PlacedLaw]:
        """Placed laws by id. The first request for a curve computes the nominal values of all curves."""
        wanted = list(ids)
        if self._curve_nominals_pending and {placed.id for placed in self._curves()} & set(wanted):
            for id_, size in self._curve_nominals_pending.pop()().items():
                self._placed[id_] = replace(self._placed[id_], nominals={"x_n": size})
        return [self._placed[id_] for id_ in wanted]

    def _curves(self) -> list[PlacedLaw]:
        """Learned curves in replaceable models."""
        return [
            placed for placed in self._placed.values() if placed.port.replaceable is not None and placed.law.curve_input
        ]

    def _curve_nominals(
        self, calibration: Calibration, fit: Optimum, open_simulator: OpenSimulator
    ) -> dict[str, float]:
        """Nominal value of the input of each curve, from a simulation at the fit; empty if that fails."""
        placed_laws = self._curves()
        flat, names = with_curve_inputs(self._redeclared(placed_laws), placed_laws)
        found: dict[str, float] = {}
        with suppress(InputError):
            own = self.transfer(calibration, self._export(flat, "curves"))
            seen = simulated_signals(own, list(names.values()), fit, open_simulator)
            found = {id_: float(f"{signal_nominal(seen[name]) or 1.0:.3g}") for id_, name in names.items()}
        return found

    def _ordered(self, ids: Iterable[str]) -> list[PlacedLaw]:
        """Placed laws in the order in which they are composed.

        Those in replaceable models come first, in their own order. Of the others, laws that need the derivative of a
        reading are the innermost.
        """
        places = {id_: k for k, id_ in enumerate(self._placed)}
        inside, others = split_by_replaceable(self._sized(ids))
        inside = sorted(inside, key=lambda u: places[u.id])
        return [*inside, *sorted(others, key=lambda u: not u.law.needs_derivative)]

    def extend(self, ids: Sequence[str], values: Mapping[str, float], folder: Path) -> ExtendedModel:
        """Return the model with chosen laws, written as Modelica and exported.

        The text has all of them, as any tool can run it; what is simulated has no equations of a delay that moves a
        recorded input.
        """
        taken = self._taken()
        placed_laws: list[PlacedLaw] = []
        names: dict[str, tuple[tuple[str, str], ...]] = {}
        for old in self._ordered(ids):
            own = {p.name: to_significant_digits(values[old.names[p.name]], 6) for p in old.parameters()}
            placed = place_law(
                old.law,
                old.port,
                taken,
                nominals=old.nominals,
                values=own,
                neighbour=old.neighbour,
                alias=old.alias,
                with_starts=True,
            )
            taken |= {placed.instance, *placed.names.values()}
            placed_laws.append(replace(placed, moved_input=old.moved_input))
            self._read.update(_read_by(placed))
            names[old.id] = tuple((old.names[p.name], placed.names[p.name]) for p in old.parameters())
        written, model = self._write(placed_laws, values, folder)
        if any(placed.moved_input for placed in placed_laws):
            model = self._simulated(placed_laws)
        parameters = tuple(p for placed in placed_laws for p in fitted_parameters(placed))
        widths = {u.id: u.law.widths for u in placed_laws}
        return ExtendedModel(written.name, written.path, written.text, written.diff, model, parameters, names, widths)

    def _write(
        self, placed_laws: Sequence[PlacedLaw], values: Mapping[str, float], folder: Path
    ) -> tuple[WrittenModel, Model]:
        """Return the written model and its FMU. ``values`` of the fit go by the names of the model with candidates."""
        written = write_laws(self.sources, self.base, self.flat, placed_laws, folder)
        flat = load_flat(written.name, (*self.sources, written.path), self.libraries)
        return written, self._export(flat, written.name)

    def transfer(self, calibration: Calibration, model: Model) -> Calibration:
        """Return the calibration of the base model, for a member of the family. States get their names there."""
        return calibration_on(calibration, model, self._states_there(calibration, model))

    def _states_there(self, calibration: Calibration, model: Model) -> Mapping[str, str]:
        """Return names in another model of states of a calibration's."""
        there = states_by_base_name(model, self._structure, self._aliases, self._read)
        return state_names(calibration.model, self._structure, there)

    @cached_property
    def _aliases(self) -> dict[str, str]:
        return state_aliases(self.base_model())

    def describe(self, id_: str) -> str:
        """Return a sentence about a law and its port."""
        return describe_law(self._placed[id_].law, self._placed[id_].port)

    def _export(self, flat: FlatModel, what: str) -> Model:
        """Return the FMU of a flat model. The hash of the flat model is part of the file name."""
        key = hashlib.sha256(repr(flat).encode()).hexdigest()[:16]
        out = self.folder / f"{self.title}-{what}-{key}.fmu"
        if not out.exists():
            self.folder.mkdir(parents=True, exist_ok=True)
            export_flat(flat, out, quick=what in _TRIED, members=declared_members(self.base, self.sources))
        return Model.load(out)


def _read_by(placed: PlacedLaw) -> dict[str, str]:
    """Return the output on which a law acts, by the name of the variable that the law reads instead."""
    return {f"{placed.instance}.u": placed.port.signals["u"]} if placed.port.attachment == "output" else {}
