"""A Modelica model and its relatives: laws at the ports that are found in it, and at its replaceable models."""

from __future__ import annotations

import hashlib
import tempfile
import zipfile
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from aero_bayes.declared import PackageDeclaration
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.declared import declared_overrides
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.estimate.parameters import Override, Parameter
from aero_bayes.export.compose import TRUE
from aero_bayes.export.embedded import export_flat
from aero_bayes.export.flat import FlatModel
from aero_bayes.export.library import declaration_of, declared_members
from aero_bayes.export.rumoca_front import load_flat
from aero_bayes.language.sources import Sources
from aero_bayes.laws.candidate_filter import CandidateFilter
from aero_bayes.laws.candidates import (
    Candidate,
    declared_candidates,
    find_candidates,
    ports_with_laws,
    with_applicable_laws,
)
from aero_bayes.laws.compose import LawModels, compose_laws, law_models
from aero_bayes.laws.law import Law, read_laws, shipped_laws
from aero_bayes.laws.learned_curve import curve_basis, curve_variable, isolated_curve, with_curve_inputs
from aero_bayes.laws.model_family import (
    CandidateTerm,
    CurveBasis,
    ExtendedModel,
    ModelWithCandidates,
    OpenSimulator,
    calibration_on,
    to_significant_digits,
)
from aero_bayes.laws.model_sources import read_sources, reserved_names
from aero_bayes.laws.placed_law import PlacedLaw, describe_law, place_law, place_laws
from aero_bayes.laws.redeclare import can_be_combined, load_with_redeclarations, split_by_replaceable
from aero_bayes.laws.replaceable_laws import laws_for_constraint
from aero_bayes.laws.starting_values import fitted_parameters, starting_values
from aero_bayes.laws.write_model import WrittenModel, write_law, write_laws
from aero_bayes.ports import (
    Port,
    alias_structure,
    find_replaceable_models,
    port_nominals,
    replaceable_ports,
    signal_nominal,
    simulated_signals,
)
from aero_bayes.simulation.model import Model, ModelicaSource

#: Sizes of ports by their ids.
PortNominals = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True)
class ModelicaFamily:
    """A model, and how it may be extended.

    Parameters
    ----------
    base : str
        Name of a Modelica class.
    sources : tuple of Path
        Files and package folders that it is loaded from; laws that stand in them count beside the shipped ones.
    folder : Path
        Where FMUs are kept.
    narrowed : Narrowed
    """

    base: str
    sources: tuple[Path, ...]
    folder: Path
    libraries: tuple[Path, ...] = ()
    candidate_filter: CandidateFilter = field(default_factory=CandidateFilter)
    _placed: dict[str, PlacedLaw] = field(default_factory=dict, compare=False, repr=False)
    _read: dict[str, str] = field(default_factory=dict, compare=False, repr=False)
    _starts: dict[str, tuple[tuple[float, ...], ...]] = field(default_factory=dict, compare=False, repr=False)
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
        """What its package declares of it."""
        return declaration_of(self.base, self.sources)

    @cached_property
    def _sources(self) -> Sources:
        return read_sources(self.sources, self.flat)

    @cached_property
    def replaceable_laws(self) -> tuple[Law, ...]:
        """Laws for its replaceable models."""
        found = dict.fromkeys(one.constraint for one in find_replaceable_models(self._sources, self.base))
        return tuple(law for constraint in found for law in laws_for_constraint(self._sources, constraint))

    @cached_property
    def replaceables(self) -> tuple[Port, ...]:
        """Its replaceable models for which there are laws."""
        usable = {law.constraint for law in self.replaceable_laws}
        found = [one for one in find_replaceable_models(self._sources, self.base) if one.constraint in usable]
        return with_applicable_laws(replaceable_ports(found, self.declared.ports), self.replaceable_laws)

    @cached_property
    def ports(self) -> tuple[Port, ...]:
        """All places where a law may act."""
        found = ports_with_laws(self.flat, self.laws)
        taken = {p.id for p in found}
        return (*found, *(replace(p, id=f"model_{p.id}") if p.id in taken else p for p in self.replaceables))

    @cached_property
    def every(self) -> tuple[Candidate, ...]:
        """Every law at every port that it fits; where the package names effects, these and learned curves alone."""
        found = find_candidates(self.ports, (*self.laws, *self.replaceable_laws))
        return declared_candidates(found, self.declared) if self.declared.effects else found

    @cached_property
    def law_models(self) -> LawModels:
        return law_models(self.laws)

    def plain(self) -> Model:
        """The model itself."""
        source = ModelicaSource(self.base, self.sources, self.libraries)
        return replace(self._export(self.flat, "plain"), source=source)

    def overrides(self, model: Model) -> Mapping[str, Override]:
        """The declared priors."""
        return declared_overrides(model)

    @property
    def extra_terms_are_free(self) -> bool:
        """Whether all laws stand in replaceable models, and one model has them all; others come as asked for."""
        return all(can_be_combined(placed) for placed in self._placed.values())

    def check(self) -> None:
        """Raise InputError where the engineer's choice names what there is not, or leaves nothing."""
        laws = {c.law.id: None for c in self.every} | {law.id: None for law in self.laws if not self.declared.effects}
        ports = {self.named(c.port): None for c in self.every} | {p.id: None for p in self.ports}
        self.candidate_filter.check([c.id for c in self.every], list(laws), list(ports))
        self._kept(self.every)

    def _kept(self, found: Sequence[Candidate]) -> list[Candidate]:
        kept = [c for c in found if self.candidate_filter.accepts(c.id, c.law.id, self.named(c.port))]
        if not kept:
            left = "[loop] effects, exclude, ports and laws leave none"
            raise InputError(f"{self.base}: no law is left to try; {left}")
        return kept

    def named(self, port: Port) -> str:
        """The name that a port goes by; several may share one."""
        return self.declared.ports.get(port.id, port.id)

    def prepare(self, calibration: Calibration, fit: Optimum, open_simulator: OpenSimulator) -> tuple[str, ...]:
        """Every law at every port that it fits."""
        kept = self._kept(self._candidates(calibration))
        found = any(c.port.replaceable is None for c in kept)
        nominals = self._nominals(calibration, fit, open_simulator) if found else {}
        highest = max((float(np.abs(s.values).max()) for e in calibration.experiments for s in e.inputs), default=1.0)
        self._placed.clear()
        for placed in place_laws(kept, self._taken(), nominals):
            self._placed[placed.id] = placed
            self._starts[placed.id] = starting_values(placed, self.declared.effects.get(placed.id), highest)
            self._read.update(_read_by(placed))
        self._curve_nominals_pending[:] = [partial(self._curve_nominals, calibration, fit, open_simulator)]
        return tuple(self._placed)

    def _candidates(self, calibration: Calibration) -> Sequence[Candidate]:
        return self.tried()

    def tried(self) -> tuple[Candidate, ...]:
        """Every law at every port where the source has a place for one."""
        every = self.every
        edited = {c.port.id: c for c in every if c.port.attachment in ("equation", "signal")}.values()
        barred = {c.port.id for c in edited if not self._can_be_written(c)}
        return tuple(c for c in every if c.port.id not in barred)

    def _can_be_written(self, c: Candidate) -> bool:
        placed = place_law(c.law, c.port, self._taken(), nominals={}, neighbour=c.neighbour)
        try:
            with tempfile.TemporaryDirectory() as folder:
                write_law(self.sources, self.base, self.flat, [placed], folder)
        except InputError:
            return False
        return True

    def _nominals(self, calibration: Calibration, fit: Optimum, open_simulator: OpenSimulator) -> PortNominals:
        return port_nominals(self.flat, self.ports, calibration, fit, open_simulator)

    def _taken(self) -> set[str]:
        """Names that the model has."""
        return reserved_names(self.flat, self.sources)

    def groups(self) -> tuple[tuple[str, ...], ...]:
        """Laws in replaceable models, then those without states, each together; those with states, which slow a
        simulation down, by port; one by one those in a replaceable model that takes only one; curves last."""
        curves, finer = self.curves(), self.refinements()
        alone = [
            id_
            for id_, placed in self._placed.items()
            if placed.port.replaceable is not None and not can_be_combined(placed)
        ]
        laws = {id_: placed for id_, placed in self._placed.items() if id_ not in curves and id_ not in alone}
        inside = tuple(id_ for id_, placed in laws.items() if placed.port.replaceable is not None)
        still = tuple(
            id_ for id_, placed in laws.items() if placed.port.replaceable is None and not placed.law.has_states
        )
        by_port: dict[str, list[str]] = {}
        for id_, placed in laws.items():
            if placed.law.has_states and placed.port.replaceable is None:
                by_port.setdefault(placed.port.id, []).append(id_)
        every = [c for c in curves if c not in alone]
        tiers = (tuple(c for c in every if (c in finer) is fine) for fine in (False, True))
        moving = (tuple(ids) for ids in by_port.values())
        return tuple(g for g in (inside, still, *moving, *((id_,) for id_ in alone), *tiers) if g)

    def refinements(self) -> Mapping[str, str]:
        """Laws that refine one at the same port."""
        known = {(placed.law.id, placed.port.id): id_ for id_, placed in self._placed.items()}
        coarse = {id_: known.get((placed.law.refines, placed.port.id)) for id_, placed in self._placed.items()}
        return {id_: of for id_, of in coarse.items() if of is not None}

    def curves(self) -> Mapping[str, str]:
        """Curves that stand for no law, and over what each is learned."""
        return {id_: curve_variable(placed) for id_, placed in self._placed.items() if placed.law.curve_input}

    def basis(self, id_: str) -> CurveBasis:
        """Of a curve that is learned."""
        (placed,) = self._sized([id_])
        if placed.port.replaceable is None:
            return curve_basis(placed, self.law_models)
        return curve_basis(*isolated_curve(self._redeclared([placed]), placed))

    def parameters(self, id_: str) -> tuple[Parameter, ...]:
        """Those of a candidate, by their names in offers."""
        return tuple(fitted_parameters(self._placed[id_]))

    def starts(self, id_: str) -> tuple[tuple[float, ...], ...]:
        """Values of a candidate's parameters worth starting from; none of a learned curve."""
        return self._starts[id_]

    def with_candidates(self, ids: Collection[str]) -> ModelWithCandidates:
        """The model with some laws, switched off, and with all in its replaceable models that go together."""
        curves = self.curves()
        inside = any(self._placed[id_].port.replaceable is not None for id_ in ids)
        also = {id_ for id_, placed in self._placed.items() if can_be_combined(placed) and id_ not in curves}
        placed_laws = self._ordered(id_ for id_ in self._placed if id_ in ids or (inside and id_ in also))
        model = self._with(placed_laws)
        own = [(CandidateTerm(u.id, self.named(u.port), self.starts(u.id)), self.parameters(u.id)) for u in placed_laws]
        return ModelWithCandidates(model, tuple(p for _, ps in own for p in ps), tuple((c, len(ps)) for c, ps in own))

    def _with(self, placed_laws: Sequence[PlacedLaw]) -> Model:
        inside, others = split_by_replaceable(placed_laws)
        flat = self._redeclared(inside)
        if others:
            flat = compose_laws(flat, self._found_in(flat, others) if inside else others, self.law_models)
        return self._export(flat, "offer")

    def _redeclared(self, placed_laws: Sequence[PlacedLaw]) -> FlatModel:
        """The model with laws in its replaceable models."""
        if not placed_laws:
            return self.flat
        return load_with_redeclarations(self.base, f"{self.title}_offer", placed_laws, self.sources, self.libraries)

    def _found_in(self, flat: FlatModel, placed_laws: Sequence[PlacedLaw]) -> list[PlacedLaw]:
        """The same laws at the ports of a relative."""
        there = {p.id: p for p in ports_with_laws(flat, self.laws)}
        needed = {p.id for placed in placed_laws for p in (placed.port, placed.neighbour) if p is not None}
        if lost := sorted(needed - there.keys()):
            raise CannotFinishError(f"{self.base}: no port {lost[0]!r} is left beside laws in its replaceable models")
        return [
            replace(
                placed, port=there[placed.port.id], neighbour=there[placed.neighbour.id] if placed.neighbour else None
            )
            for placed in placed_laws
        ]

    def _sized(self, ids: Iterable[str]) -> list[PlacedLaw]:
        """Uses by id; the first curve that is asked for gives all in replaceable models their sizes."""
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
        """How far a fit goes in what each curve is learned over; nothing where it cannot be simulated with them."""
        placed_laws = self._curves()
        flat, names = with_curve_inputs(self._redeclared(placed_laws), placed_laws)
        found: dict[str, float] = {}
        with suppress(InputError):
            own = self.on(calibration, self._export(flat, "watched"))
            seen = simulated_signals(own, list(names.values()), fit, open_simulator)
            found = {id_: float(f"{signal_nominal(seen[name]) or 1.0:.3g}") for id_, name in names.items()}
        return found

    def _ordered(self, ids: Iterable[str]) -> list[PlacedLaw]:
        """Uses in the order in which they are composed: those in replaceable models as listed; of the others, laws that
        need the rate of a reading are the innermost."""
        places = {id_: k for k, id_ in enumerate(self._placed)}
        inside, others = split_by_replaceable(self._sized(ids))
        inside = sorted(inside, key=lambda u: places[u.id])
        return [*inside, *sorted(others, key=lambda u: not u.law.needs_derivative)]

    def extend(self, ids: Sequence[str], values: Mapping[str, float], folder: Path) -> ExtendedModel:
        """The model with chosen laws, written as Modelica."""
        taken = self._taken()
        placed_laws: list[PlacedLaw] = []
        names: dict[str, tuple[tuple[str, str], ...]] = {}
        for old in self._ordered(ids):
            own = {p.name: to_significant_digits(values[old.names[p.name]], 6) for p in old.parameters()}
            placed = place_law(
                old.law, old.port, taken, nominals=old.nominals, values=own, neighbour=old.neighbour, alias=old.alias
            )
            taken |= {placed.instance, *placed.names.values()}
            placed_laws.append(placed)
            self._read.update(_read_by(placed))
            names[old.id] = tuple((old.names[p.name], placed.names[p.name]) for p in old.parameters())
        written, model = self._write(placed_laws, values, folder)
        parameters = tuple(p for placed in placed_laws for p in fitted_parameters(placed))
        widths = {u.id: u.law.widths for u in placed_laws}
        return ExtendedModel(written.name, written.path, written.text, written.diff, model, parameters, names, widths)

    def _write(
        self, placed_laws: Sequence[PlacedLaw], values: Mapping[str, float], folder: Path
    ) -> tuple[WrittenModel, Model]:
        """The written model and its FMU; ``values`` are those of the fit, by the names of the offers."""
        written = write_laws(self.sources, self.base, self.flat, placed_laws, folder)
        flat = load_flat(written.name, (*self.sources, written.path), self.libraries)
        return written, self._export(flat, written.name)

    def on(self, calibration: Calibration, model: Model) -> Calibration:
        """The calibration on a relative: a state takes the name of what it equals there."""
        structure = alias_structure(self.flat)
        there: dict[str, str] = {}
        for s in model.states:
            # what an output's law reads is what the output was
            unread = s.name.removesuffix(TRUE).replace(f"{TRUE}[", "[")
            was = self._read.get(s.name, unread if s.name not in self._aliases else s.name)
            there.setdefault(self._aliases.get(was, was), s.name)
            if was in structure.variables:
                there.setdefault(structure.of(was), s.name)
        known = {s.name: structure.of(s.name) for s in calibration.model.states if s.name in structure.variables}
        names = {s: there.get(s, there.get(same, s)) for s, same in known.items()}
        return calibration_on(calibration, model, names)

    @cached_property
    def _aliases(self) -> dict[str, str]:
        """A state of the model by the name of each variable that equals it."""
        model = self.plain()
        with zipfile.ZipFile(model.path) as archive:
            root = ElementTree.fromstring(archive.read("modelDescription.xml"))
        states = {str(s.value_reference): s.name for s in model.states}
        variables = [(v.get("name", ""), v.get("valueReference", "")) for v in root.iter("ScalarVariable")]
        return {name: states[reference] for name, reference in variables if reference in states}

    def summary(self, id_: str) -> str:
        """A law in words."""
        return describe_law(self._placed[id_].law, self._placed[id_].port)

    def _export(self, flat: FlatModel, what: str) -> Model:
        """The FMU of a flat model, kept under the hash of what it was made from."""
        key = hashlib.sha256(repr(flat).encode()).hexdigest()[:16]
        out = self.folder / f"{self.title}-{what}-{key}.fmu"
        if not out.exists():
            self.folder.mkdir(parents=True, exist_ok=True)
            export_flat(flat, out, members=declared_members(self.base, self.sources))
        return Model.load(out)


def _read_by(placed: PlacedLaw) -> dict[str, str]:
    """The output that a law stands before, by the law's own name for its quantity."""
    return {f"{placed.instance}.u": placed.port.signals["u"]} if placed.port.attachment == "output" else {}
