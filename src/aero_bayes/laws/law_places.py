"""Where laws may act in a Modelica model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

from aero_bayes.declared import PackageDeclaration
from aero_bayes.errors import InputError
from aero_bayes.estimate.measured_data import MeasuredData
from aero_bayes.export.flat import FlatModel
from aero_bayes.export.library import declaration_of
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
from aero_bayes.laws.compose import LawModels, law_models
from aero_bayes.laws.law import Law, read_laws, shipped_laws
from aero_bayes.laws.model_sources import read_sources, reserved_names
from aero_bayes.laws.open_replaceables import effect_models
from aero_bayes.laws.placed_law import place_law
from aero_bayes.laws.replaceable_laws import laws_for_constraint
from aero_bayes.laws.write_model import can_be_written
from aero_bayes.ports import (
    AliasStructure,
    Port,
    ReplaceableModel,
    alias_structure,
    find_replaceable_models,
    replaceable_ports,
)


@dataclass(frozen=True)
class LawPlaces:
    """A Modelica model, its ports, and the laws that may act there.

    Parameters
    ----------
    base : str
        Name of the Modelica class.
    sources : tuple of Path
        Files and package folders from which it is loaded. Laws in them are candidates, as the shipped ones are.
    libraries : tuple of Path
        Folders that hold packages which the model uses.
    candidate_filter : CandidateFilter
        The candidates that the user allows.
    """

    base: str
    sources: tuple[Path, ...] = ()
    libraries: tuple[Path, ...] = ()
    candidate_filter: CandidateFilter = field(default_factory=CandidateFilter)

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
        """Each law as a flat model of its own."""
        found = dict(law_models(self.laws))
        if self.replaceable_laws:
            inputs = {law.constraint: self._inputs_of(law.constraint) for law in self.replaceable_laws}
            effects = effect_models(self.replaceable_laws, inputs, self.sources, self.libraries)
            found |= {("replaceable", id_): flat for id_, flat in effects.items()}
        return found

    def _inputs_of(self, constraint: str) -> list[str]:
        chain = self._sources.lineage(*self._sources.find(constraint))
        return [c.name for _, cls in chain for c in cls.components() if "input" in c.prefixes]

    def check(self) -> None:
        """Raise InputError if the candidate filter names something unknown, or rejects all candidates."""
        laws = {c.law.id: None for c in self.candidates}
        laws |= {law.id: None for law in self.laws if not self.declared.effects}
        ports = {self.port_name(c.port): None for c in self.candidates} | {p.id: None for p in self.ports}
        self.candidate_filter.check([c.id for c in self.candidates], list(laws), list(ports))
        self.allowed(self.candidates)

    def allowed(self, found: Sequence[Candidate]) -> list[Candidate]:
        """Keep the candidates that the filter accepts. Raises InputError if there is none."""
        kept = [c for c in found if self.candidate_filter.accepts(c.id, c.law.id, self.port_name(c.port))]
        if not kept:
            left = "[loop] effects, exclude, ports and laws leave none"
            raise InputError(f"{self.base}: no law is left to try; {left}")
        return kept

    def port_name(self, port: Port) -> str:
        """Return the declared name of a port, which several ports may share; else its id."""
        return self.declared.ports.get(port.id, port.id)

    def candidates_for(self, data: MeasuredData) -> Sequence[Candidate]:
        """Return the candidates that may act on the model of a calibration."""
        return self.writable_candidates()

    def writable_candidates(self) -> tuple[Candidate, ...]:
        """Return the candidates that can be written into the source."""
        every = self.candidates
        edited = {c.port.id: c for c in every if c.port.attachment in ("equation", "signal")}.values()
        laws = [place_law(c.law, c.port, self.taken_names(), nominals={}, neighbour=c.neighbour) for c in edited]
        barred = {p.port.id for p in laws if not can_be_written(self.sources, self.base, self.flat, p)}
        return tuple(c for c in every if c.port.id not in barred)

    def taken_names(self) -> set[str]:
        """Return names that the model uses already."""
        return reserved_names(self.flat, self.sources)

    @cached_property
    def structure(self) -> AliasStructure:
        """Which variables are equal to one another, up to the sign."""
        return alias_structure(self.flat)
