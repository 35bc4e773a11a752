"""Where laws may act around an FMU without source: at its inputs, its outputs and at forces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from aero_bayes.declared import PackageDeclaration
from aero_bayes.errors import InputError
from aero_bayes.estimate.measured_data import MeasuredData
from aero_bayes.laws.candidates import Candidate, find_candidates
from aero_bayes.laws.fmu_ports import FmuBoundary
from aero_bayes.laws.law import Law
from aero_bayes.laws.law_places import LawPlaces
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
