"""The family of an FMU without source: laws around it, at its inputs, its outputs and at forces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.export.embedded import export_flat
from aero_bayes.files import whole_file
from aero_bayes.language.edits import unified_diff
from aero_bayes.laws.attach import OpenModel, attached
from aero_bayes.laws.coupled_fmu import UNREAD_SUFFIX, couple
from aero_bayes.laws.fmu_places import FmuPlaces
from aero_bayes.laws.fmu_ports import LawCoupling
from aero_bayes.laws.fmu_wrapper import wrapper_text, write_ssp
from aero_bayes.laws.model_family import OpenSimulator
from aero_bayes.laws.modelica_family import ModelicaFamily, PortNominals
from aero_bayes.laws.placed_law import PlacedLaw
from aero_bayes.laws.write_model import WrittenModel
from aero_bayes.ports import (
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
    """An FMU, the base model, and the same FMU with laws around it."""

    places: FmuPlaces
    _fixed_values: dict[str, float] = field(default_factory=dict, compare=False, repr=False)

    @property
    def inner(self) -> Model:
        """The FMU."""
        return self.places.inner

    def base_model(self) -> Model:
        """Return the FMU itself."""
        return self.inner

    def prepare(self, calibration: Calibration, fit: Optimum, open_simulator: OpenSimulator) -> tuple[str, ...]:
        """Place the candidates; see the base class."""
        self._fixed_values.clear()
        self._fixed_values.update(calibration.simulated.fixed)
        return super().prepare(calibration, fit, open_simulator)

    def _nominals(self, calibration: Calibration, fit: Optimum, open_simulator: OpenSimulator) -> PortNominals:
        """Compute nominal values from the fit. Those of a force are from its recording, or its nominal attribute."""
        inner = self.inner
        names = {v.name for v in inner.outputs if v.kind == "real"}
        states = [s.name for s in inner.states]
        found = simulated_signals(calibration, sorted({*names, *states}), fit, open_simulator)
        seen = {name: signal_nominal(parts) or 1.0 for name, parts in found.items()}
        given = {
            v.name: signal_nominal([s.values for s in recorded_inputs(calibration.data, v.name)]) or v.nominal or 1.0
            for v in inner.inputs
        }
        time = fastest_time_scale(calibration.data)
        nominals: dict[str, Mapping[str, float]] = {}
        for port in self.places.ports:
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
                    "w_n": relative_change(recorded_inputs(calibration.data, port.id), time),
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

    def _opened(self) -> OpenModel:
        return self.places.boundary.opened()

    def _with(self, placed_laws: Sequence[PlacedLaw]) -> Model:
        return self._attached(placed_laws)

    def _coupling(self, placed_laws: Sequence[PlacedLaw]) -> LawCoupling:
        return self.places.boundary.coupling(placed_laws, self.places.law_models)

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
        export_flat(coupling.flat, laws)
        couple(attached(self._opened(), placed_laws, self.blocks), folder / f"{name}.fmu")
        write_ssp(self.inner, laws, coupling, values, folder / f"{name}.ssp")
        before = wrapper_text(self.inner, none, (), values, name)
        return WrittenModel(name, path, text, unified_diff(before, text, f"{self.title}.mo", path.name)), Model.load(
            folder / f"{name}.fmu"
        )

    def _states_there(self, base: Model, model: Model) -> Mapping[str, str]:
        """Return names in a coupled model of states that are outputs, which may have others there."""
        there = {s.name for s in model.states}
        return {s.name: f"{s.name}{UNREAD_SUFFIX}" for s in self.inner.states if s.name not in there}
