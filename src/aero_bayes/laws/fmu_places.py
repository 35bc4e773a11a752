"""Where laws may act around an FMU without source: at its inputs, its outputs and at forces."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from aero_bayes.declared import PackageDeclaration
from aero_bayes.errors import InputError
from aero_bayes.estimate.measured_data import MeasuredData
from aero_bayes.laws.candidates import Candidate, find_candidates
from aero_bayes.laws.fmu_ports import INSIDE, FmuBoundary
from aero_bayes.laws.formula_places import FormulaPort
from aero_bayes.laws.formula_terms import FormulaSignals
from aero_bayes.laws.law import Law
from aero_bayes.laws.law_places import LawPlaces
from aero_bayes.laws.placed_law import PlacedLaw
from aero_bayes.ports import Port
from aero_bayes.simulation import Model


@dataclass(frozen=True)
class FmuPlaces(LawPlaces):
    """An FMU, its ports, and the laws that may act around it."""

    fmu: Path = Path()

    @cached_property
    def inner(self) -> Model:
        return Model.load(self.fmu)

    @cached_property
    def boundary(self) -> FmuBoundary:
        return FmuBoundary(self.inner, self.laws)

    @cached_property
    def declared(self) -> PackageDeclaration:
        """An empty declaration: ports and laws around an FMU are found, not declared."""
        return PackageDeclaration()

    @cached_property
    def replaceable_laws(self) -> tuple[Law, ...]:
        """Empty: an FMU has no replaceable models."""
        return ()

    @cached_property
    def ports(self) -> tuple[Port, ...]:
        return self.boundary.ports

    def check(self) -> None:
        """Raise InputError for an FMU without Model Exchange, and as for any model."""
        if self.inner.interface != "model exchange":
            raise InputError(f"{self.fmu}: the loop needs Model Exchange; this FMU has co-simulation only")
        super().check()

    def taken_names(self) -> set[str]:
        inner = self.inner
        every = (*inner.parameters, *inner.inputs, *inner.outputs, *inner.states)
        return {v.name for v in every} | set(self.boundary.names.values())

    def candidates_for(self, data: MeasuredData) -> Sequence[Candidate]:
        """Return all candidates. At an input that no recording has, only an offset."""
        driven = {s.name for e in data.experiments for s in e.inputs}
        return [
            c
            for c in find_candidates(self.ports, self.laws)
            if c.port.kind != "input" or c.port.id in driven or c.law.id == "offset"
        ]


@dataclass(frozen=True)
class FmuSignals(FormulaSignals):
    """Variables of an FMU that formulas around it may read; ``sizes`` are typical sizes of its states."""

    places: FmuPlaces
    sizes: dict[str, float] = field(default_factory=dict)

    def variables(self) -> Mapping[str, tuple[str, str]]:
        """Return the variables, and their units. An output that equals a state is read at its port only."""
        boundary, inner = self.places.boundary, self.places.inner
        every = (*(v for v in inner.outputs if v.kind == "real"), *inner.inputs)
        found = {v.name: (boundary.names[v.name], v.unit) for v in every}
        return found | {s.name: (boundary.state_signal(s), s.unit) for s in inner.states}

    def of_place(self, place: FormulaPort) -> str:
        """Return the signal at an input or output, or the speed that a force drives."""
        return place.port.signals.get("u", place.port.signals.get("v", ""))

    def read_at(self, place: FormulaPort) -> list[str]:
        return [*place.port.signals.values()]

    def parameter_ports(self, free: Collection[str]) -> Iterator[FormulaPort]:
        """Yield none: what uses a parameter is inside of the FMU."""
        return iter(())

    def state_sizes(self, placed_laws: Iterable[PlacedLaw]) -> Mapping[str, float]:
        """Return typical sizes of all states, from the fit of the FMU alone."""
        return dict(self.sizes)

    def for_readers(self, text: str) -> str:
        return text.replace(INSIDE, "")
