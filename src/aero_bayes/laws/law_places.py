"""Where laws may act in a Modelica model."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

from aero_bayes.declared import PackageDeclaration
from aero_bayes.errors import InputError
from aero_bayes.estimate.measured_data import MeasuredData
from aero_bayes.laws.aliases import AliasStructure, alias_structure
from aero_bayes.laws.balance import Port
from aero_bayes.laws.candidates import (
    Candidate,
    declared_candidates,
    describe_law,
    find_candidates,
    place_law,
    ports_with_laws,
    with_twins,
)
from aero_bayes.laws.law import Law, read_laws, shipped_laws
from aero_bayes.laws.law_models import LawModels, law_models
from aero_bayes.laws.write_model import can_be_written, reserved_names
from aero_bayes.modelica.flat import FlatModel
from aero_bayes.modelica.library import declaration_of, rig_packages
from aero_bayes.modelica.rumoca_front import load_flat
from aero_bayes.unknown_names import closest_name

#: What the names under each key mean.
KEY_MEANINGS = {
    "effects": "effect", "exclude": "effect, law or port", "ports": "port", "laws": "law", "require": "effect",
}  # fmt: skip


#: What the ids begin with of a value that is held fixed and may be wrong, and of the start of a state: ``value@J_p``.
VALUE, START = "value@", "start@"


def is_held(term: str) -> bool:
    """Whether a term stands for a value or a start that was held."""
    return term.startswith((VALUE, START))


@dataclass(frozen=True)
class CandidateFilter:
    """A filter of effects by id, law and port."""

    effects: tuple[str, ...] | None = None
    exclude: tuple[str, ...] = ()
    ports: tuple[str, ...] | None = None
    laws: tuple[str, ...] | None = None
    require: tuple[str, ...] = ()

    def accepts(self, id_: str, law: str, port: str) -> bool:
        """Return whether an effect is accepted."""
        return id_ in self.require or (
            not {id_, law, port} & set(self.exclude)
            and (self.effects is None or bool({id_, law} & set(self.effects)))
            and (self.ports is None or port in self.ports)
            and (self.laws is None or law in self.laws)
        )

    def check(self, ids: Collection[str], laws: Collection[str], ports: Collection[str]) -> None:
        """Raise InputError for an unknown name, with the closest known one, or a name both required and excluded."""
        for key, names, known in (
            ("effects", self.effects or (), [*ids, *laws]),
            ("exclude", self.exclude, [*ids, *laws, *ports]),
            ("ports", self.ports or (), [*ports]),
            ("laws", self.laws or (), [*laws]),
            ("require", self.require, [*ids]),
        ):
            for name in names:
                if name not in known and not is_held(name):
                    close = closest_name(name, known, cutoff=0.0)
                    hint = f"did you mean {close!r}?" if close is not None else "there is none"
                    told = f"{key}: unknown {KEY_MEANINGS[key]} {name!r}; {hint}"
                    raise InputError(told, f"[loop] {told}")
        for name in self.require:
            if name in self.exclude:
                told = f"require and exclude both name {name!r}"
                raise InputError(told, f"[loop] {told}")


@dataclass(frozen=True)
class LawPlaces:
    """A Modelica class, its ports, and the laws that may act there, those in its ``sources`` among them."""

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
        """The shipped laws, those of the rig's own package, and those in the user's sources."""
        own = [folder for folder in rig_packages() if folder.name == self.declared.package]
        return (*shipped_laws(), *read_laws([*own, *self.sources]))

    @cached_property
    def declared(self) -> PackageDeclaration:
        """What the package of the model declares about it."""
        return declaration_of(self.base, self.sources)

    @cached_property
    def ports(self) -> tuple[Port, ...]:
        """All places where a law may act."""
        return ports_with_laws(self.flat, self.laws)

    @cached_property
    def candidates(self) -> tuple[Candidate, ...]:
        """Every applicable law at every port. If the package names effects, only these."""
        found = find_candidates(self.ports, self.laws)
        return declared_candidates(found, self.declared) if self.declared.effects else with_twins(found)

    @cached_property
    def law_models(self) -> LawModels:
        """Each law as a flat model of its own."""
        return law_models(self.laws)

    def check(self) -> None:
        """Raise InputError if the candidate filter names something unknown, or rejects all candidates."""
        laws = {c.law.id: None for c in self.candidates}
        laws |= {law.id: None for law in self.laws if not self.declared.effects}
        ports = {self.port_name(c.port): None for c in self.candidates} | {p.id: None for p in self.ports}
        self.candidate_filter.check([c.id for c in self.candidates], list(laws), list(ports))
        self.allowed(self.candidates)

    def allowed(self, found: Sequence[Candidate]) -> list[Candidate]:
        """Keep the candidates that the filter accepts. Raises InputError if there is none."""
        accepts = self.candidate_filter.accepts
        kept = [c for c in found if all(accepts(c.id, c.law.id, self.port_name(one.port)) for one in c.parts)]
        if not kept:
            none, left = f"{self.base}: no law is left to try;", "effects, exclude, ports and laws leave none"
            raise InputError(f"{none} {left}", f"{none} [loop] {left}")
        return kept

    def port_name(self, port: Port) -> str:
        """Return the declared name of a port, which several ports may share; else its id."""
        return self.declared.ports.get(port.id, port.id)

    def place_name(self, c: Candidate) -> str:
        """Return the names of the ports where a candidate acts."""
        return "+".join(dict.fromkeys(self.port_name(one.port) for one in c.parts))

    def describe(self, c: Candidate) -> str:
        """Return a phrase about a law and its place; a signal of the model itself stands there by its own name."""
        own = "." not in c.port.id and not c.twins
        return describe_law(c.law, c.port, c.port.id if own else self.place_name(c))

    def candidates_for(self, data: MeasuredData) -> Sequence[Candidate]:
        """Return the candidates that can be written into the source."""
        every = self.candidates
        edited = {c.port.id: c for one in every for c in one.parts if c.port.attachment in ("equation", "signal")}
        laws = [place_law(replace(c, twins=()), self.taken_names()) for c in edited.values()]
        barred = {p.port.id for p in laws if not can_be_written(self.sources, self.base, self.flat, p)}
        return tuple(c for c in every if not barred & {one.port.id for one in c.parts})

    def taken_names(self) -> set[str]:
        """Return names that the model uses already."""
        return reserved_names(self.flat, self.sources)

    @cached_property
    def structure(self) -> AliasStructure:
        """Which variables are equal to one another, up to the sign."""
        return alias_structure(self.flat)
