"""The family of an FMU without source: laws around it, at its inputs, its outputs and at forces."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from aero_bayes.declared import PackageDeclaration
from aero_bayes.errors import InputError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.files import whole_file
from aero_bayes.language.edits import unified_diff
from aero_bayes.laws.candidates import Candidate, find_candidates
from aero_bayes.laws.fmu_coupling import couple, state_name
from aero_bayes.laws.fmu_ports import INSIDE, FmuBoundary, LawCoupling
from aero_bayes.laws.fmu_wrapper import wrapper_text, write_ssp
from aero_bayes.laws.formula_places import FormulaPort
from aero_bayes.laws.law import Law
from aero_bayes.laws.model_family import OpenSimulator
from aero_bayes.laws.modelica_family import ModelicaFamily, PortNominals
from aero_bayes.laws.placed_law import PlacedLaw
from aero_bayes.laws.write_model import WrittenModel
from aero_bayes.ports import (
    Port,
    fastest_time_scale,
    recorded_inputs,
    relative_change,
    share_visited_twice,
    signal_nominal,
    simulated_signals,
    visited_range,
)
from aero_bayes.simulation import Model


@dataclass(frozen=True)
class FmuFamily(ModelicaFamily):
    """An FMU, the base model, and the same FMU with laws around it.

    Parameters
    ----------
    base : str
        A name for it.
    sources : tuple of Path
        Modelica files with further laws.
    folder : Path
        Where FMUs are kept.
    fmu : Path
    """

    fmu: Path = Path()
    _state_sizes: dict[str, float] = field(default_factory=dict, compare=False, repr=False)
    _fixed_values: dict[str, float] = field(default_factory=dict, compare=False, repr=False)

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

    def base_model(self) -> Model:
        """Return the FMU itself."""
        return self.inner

    def check(self) -> None:
        """Raise InputError for an FMU without Model Exchange, and as for any model."""
        if self.inner.interface != "model exchange":
            raise InputError(f"{self.fmu}: the loop needs Model Exchange; this FMU has co-simulation only")
        super().check()

    def prepare(self, calibration: Calibration, fit: Optimum, open_simulator: OpenSimulator) -> tuple[str, ...]:
        """Place the candidates; see the base class."""
        self._fixed_values.clear()
        self._fixed_values.update(calibration.fixed)
        return super().prepare(calibration, fit, open_simulator)

    def _taken(self) -> set[str]:
        inner = self.inner
        every = (*inner.parameters, *inner.inputs, *inner.outputs, *inner.states)
        return {v.name for v in every} | set(self.boundary.names.values())

    def _candidates(self, calibration: Calibration) -> Sequence[Candidate]:
        """Return all candidates. At an input that no recording has, only an offset."""
        driven = {s.name for e in calibration.experiments for s in e.inputs}
        return [
            c
            for c in find_candidates(self.ports, self.laws)
            if c.port.kind != "input" or c.port.id in driven or c.law.id == "offset"
        ]

    def _nominals(self, calibration: Calibration, fit: Optimum, open_simulator: OpenSimulator) -> PortNominals:
        """Nominal values from the fit. Those of a force are from its recording, or its nominal attribute."""
        inner = self.inner
        names = {v.name for v in inner.outputs if v.kind == "real"}
        states = [s.name for s in inner.states]
        found = simulated_signals(calibration, sorted({*names, *states}), fit, open_simulator)
        seen = {name: signal_nominal(parts) or 1.0 for name, parts in found.items()}
        self._state_sizes.clear()
        self._state_sizes.update({name: seen[name] for name in states})
        given = {
            v.name: signal_nominal([s.values for s in recorded_inputs(calibration, v.name)]) or v.nominal or 1.0
            for v in inner.inputs
        }
        time = fastest_time_scale(calibration, fit)
        nominals: dict[str, Mapping[str, float]] = {}
        for port in self.ports:
            if port.kind == "motion":
                assert port.balance is not None
                force = given[inner.inputs[port.balance.equation].name]
                speed, *position = (seen[s] for s in port.states)
                place = (*position, speed * time)[0]
                read = zip(("v", "x"), port.states, strict=False)
                twice = {f"{signal}_twice": share_visited_twice(found[s]) for signal, s in read}
                nominals[port.id] = {"f_n": force, "v_n": speed, "x_n": place, "x_w": place, "t_n": time, **twice}
            elif port.kind == "input":
                nominals[port.id] = {
                    "u_n": given[port.id],
                    "w_n": relative_change(recorded_inputs(calibration, port.id), time),
                    "t_n": time,
                }
            else:
                reading = port.id.removeprefix("output_")
                nominals[port.id] = {
                    "u_n": seen[reading],
                    **visited_range("u", found[reading]),
                    "u_twice": share_visited_twice(found[reading]),
                    "t_n": time,
                }
        return nominals

    def _with(self, placed_laws: Sequence[PlacedLaw]) -> Model:
        coupling = self._coupling(placed_laws)
        key = hashlib.sha256(f"{coupling!r}{self.inner.sha256}".encode()).hexdigest()[:16]
        out = self.folder / f"{self.title}-candidates-{key}.fmu"
        if not out.exists():
            self.folder.mkdir(parents=True, exist_ok=True)
            couple(self.inner, coupling, out, self.folder / f"{self.title}-laws-{key}.fmu")
        return Model.load(out)

    def _coupling(self, placed_laws: Sequence[PlacedLaw]) -> LawCoupling:
        return self.boundary.coupling(placed_laws, {**self.law_models, **self._formula_models})

    def _parameter_ports(self, free: Collection[str]) -> Iterator[FormulaPort]:
        """Yield none: what uses a parameter is inside of the FMU."""
        return iter(())

    def _own_signal(self, place: FormulaPort) -> str:
        """Return the signal at an input or output, or the speed that a force drives."""
        return place.port.signals.get("u", place.port.signals.get("v", ""))

    def _read_at(self, place: FormulaPort) -> list[str]:
        return [*place.port.signals.values()]

    def formula_signals(self) -> Mapping[str, tuple[str, str]]:
        """Return, for each state, input and output that formulas around the FMU read: the variable, and its unit.

        An output that equals a state is read at its port only.
        """
        names, inner = self.boundary.names, self.inner
        every = (*(v for v in inner.outputs if v.kind == "real"), *inner.inputs)
        found = {v.name: (names[v.name], v.unit) for v in every}
        return found | {s.name: (self.boundary.state_signal(s), s.unit) for s in inner.states}

    def state_sizes(self) -> Mapping[str, float]:
        """Return typical sizes of all states, from the fit of the FMU alone."""
        return dict(self._state_sizes)

    def formula_text(self, id_: str, values: Mapping[str, float]) -> str:
        """Return a formula with the names of the FMU's states, its sign and numbers; empty for a listed law."""
        return super().formula_text(id_, values).replace(INSIDE, "")

    def formula_ranges(self, id_: str) -> Mapping[str, tuple[float, float]]:
        """Return the range over which each signal of a formula was seen; empty for a listed law."""
        return {name.removesuffix(INSIDE): seen for name, seen in super().formula_ranges(id_).items()}

    def _write(
        self, placed_laws: Sequence[PlacedLaw], values: Mapping[str, float], folder: Path
    ) -> tuple[WrittenModel, Model]:
        """Write ``NAME.mo`` and ``NAME.ssp`` for other tools, and ``NAME.fmu``."""
        name = "_".join([self.title, *(u.instance for u in placed_laws)])
        coupling, none = self._coupling(placed_laws), self._coupling(())
        values = {**self._fixed_values, **values}
        text = wrapper_text(self.inner, coupling, placed_laws, values, name)
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{name}.mo"
        with whole_file(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
        laws = self.folder / f"{name}-laws.fmu"
        self.folder.mkdir(parents=True, exist_ok=True)
        couple(self.inner, coupling, folder / f"{name}.fmu", laws)
        write_ssp(self.inner, laws, coupling, values, folder / f"{name}.ssp")
        before = wrapper_text(self.inner, none, (), values, name)
        return WrittenModel(name, path, text, unified_diff(before, text, f"{self.title}.mo", path.name)), Model.load(
            folder / f"{name}.fmu"
        )

    def _states_there(self, calibration: Calibration, model: Model) -> Mapping[str, str]:
        """Return names in a coupled model of states that are outputs, which may have others there."""
        there = {s.name for s in model.states}
        return {s.name: state_name(s.name, [s.name]) for s in self.inner.states if s.name not in there}
