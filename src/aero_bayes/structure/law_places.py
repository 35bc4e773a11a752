"""Where laws may act in a Modelica model."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

from aero_bayes.declared import PackageDeclaration
from aero_bayes.errors import InputError
from aero_bayes.estimate.measured_data import MeasuredData
from aero_bayes.modelica.classes import ClassText, ComponentDeclaration, snake_case
from aero_bayes.modelica.flat import FlatModel
from aero_bayes.modelica.library import declaration_of
from aero_bayes.modelica.parse import evaluate_expression, parse_expression
from aero_bayes.modelica.rumoca_front import load_flat
from aero_bayes.modelica.sources import Sources
from aero_bayes.structure.aliases import AliasStructure, alias_structure
from aero_bayes.structure.balance import Port, ReplaceableModel, find_replaceable_models
from aero_bayes.structure.candidates import (
    Candidate,
    declared_candidates,
    find_candidates,
    place_law,
    ports_with_laws,
    with_applicable_laws,
    with_twins,
)
from aero_bayes.structure.compose import LawModels, flat_components, law_models
from aero_bayes.structure.find import replaceable_ports
from aero_bayes.structure.law import (
    Law,
    LawInterface,
    annotation_text,
    is_fitted_parameter,
    law_parameter,
    read_laws,
    shipped_laws,
)
from aero_bayes.structure.write_model import can_be_written, read_sources, reserved_names
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


#: A law in place of a replaceable model brings its own connections. A learned curve is ``y`` over ``x``, and its
#: parameter ``x_n`` is the largest value of ``x`` in a fit.
REPLACEABLE_INTERFACE = LawInterface("replaceable", "y", ("x",), {"x_n": "x"})


def laws_for_constraint(known: Sources, constraint: str) -> tuple[Law, ...]:
    """Return the laws for replaceable models with a constraining class, in the order of files and classes.

    A law is a class that extends the constraining class, and whose first own parameter with a nominal value is zero by
    default."""
    found: list[Law] = []
    if constraint not in known.by_name:
        return ()
    shared = {c.full_name for _, c in known.lineage(*known.find(constraint))}
    for file in (file for file in known.files.values() if not Path(file.file).is_absolute()):
        for cls in (c for top in file.classes for c in top.walk()):
            if cls.partial or cls.kind not in ("model", "block") or cls.full_name in shared:
                continue
            chain = known.lineage(file, cls)
            if not any(c.full_name == constraint for _, c in chain):
                continue
            own = [c for _, of in chain if of.full_name not in shared for c in of.components()]
            try:
                law = _law(cls, constraint, own)
            except InputError as error:
                raise InputError(f"{file.file}: {cls.full_name}: {error}") from None
            if law is not None:
                found.append(law)
    return tuple(found)


def _law(cls: ClassText, constraint: str, own: Sequence[ComponentDeclaration]) -> Law | None:
    switches = [c for c in own if is_fitted_parameter(c)]
    if not switches or _number(switches[0]) != 0.0:
        return None
    fitted = tuple(law_parameter(c) for c in switches)
    set_from_outside = [c for c in own if "parameter" in c.prefixes and not c.prefixes & {"final", "protected"}]
    others = {
        c.name: value for c in set_from_outside if not is_fitted_parameter(c) and (value := _number(c)) is not None
    }
    nominals = {name: value for name, value in others.items() if name in REPLACEABLE_INTERFACE.nominals}
    widths = {name: value for name, value in others.items() if name not in nominals}
    for p in fitted:
        p.check(nominals)
    notes = [annotation_text(cls.annotation, word) for word in ("refines", "learned", "threshold")]
    if notes[1] not in ("", "x"):
        raise InputError(f'learned = {notes[1]!r}; expected "x", the variable over which y is learned')
    refines, learned, threshold = notes
    return Law(
        snake_case(cls.name), "replaceable", cls.full_name, cls.description, fitted, nominals, frozenset(), {}, "",
        refines, learned, threshold, REPLACEABLE_INTERFACE, "", cls, widths, constraint,
    )  # fmt: skip


def _number(c: ComponentDeclaration) -> float | None:
    try:
        return evaluate_expression(parse_expression(c.binding), {}) if c.binding else None
    except InputError:
        return None


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
        return declared_candidates(found, self.declared) if self.declared.effects else with_twins(found)

    @cached_property
    def law_models(self) -> LawModels:
        """Each law as a flat model of its own."""
        found = dict(law_models(self.laws))
        if self.replaceable_laws:
            inputs = {law.constraint: self._inputs_of(law.constraint) for law in self.replaceable_laws}
            own = {law.id: (law.model, inputs[law.constraint]) for law in self.replaceable_laws}
            effects = flat_components("EffectsAtOnce", own, self.sources, self.libraries)
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
        accepts = self.candidate_filter.accepts
        kept = [c for c in found if all(accepts(c.id, c.law.id, self.port_name(one.port)) for one in c.parts)]
        if not kept:
            none, left = f"{self.base}: no law is left to try;", "effects, exclude, ports and laws leave none"
            raise InputError(f"{none} {left}", f"{none} [loop] {left}")
        return kept

    def port_name(self, port: Port) -> str:
        """Return the declared name of a port, which several ports may share; else its id."""
        return self.declared.ports.get(port.id, port.id)

    def candidates_for(self, data: MeasuredData) -> Sequence[Candidate]:
        """Return the candidates that can be written into the source."""
        every = self.candidates
        edited = {c.port.id: c for c in every if c.port.attachment in ("equation", "signal") and not c.twins}.values()
        laws = [place_law(c, self.taken_names()) for c in edited]
        barred = {p.port.id for p in laws if not can_be_written(self.sources, self.base, self.flat, p)}
        return tuple(c for c in every if not barred & {one.port.id for one in c.parts})

    def taken_names(self) -> set[str]:
        """Return names that the model uses already."""
        return reserved_names(self.flat, self.sources)

    @cached_property
    def structure(self) -> AliasStructure:
        """Which variables are equal to one another, up to the sign."""
        return alias_structure(self.flat)
