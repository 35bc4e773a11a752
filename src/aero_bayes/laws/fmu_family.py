"""An FMU without its source and its relatives: laws around it, at its inputs, at its outputs, at forces."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from aero_bayes.declared import Declaration
from aero_bayes.errors import InputError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.local_fit import Optimum
from aero_bayes.files import whole_file
from aero_bayes.language.edits import unified_diff
from aero_bayes.laws.candidates import Candidate, candidates
from aero_bayes.laws.family import OpenSimulator, moved
from aero_bayes.laws.fmu_coupling import couple, state_name
from aero_bayes.laws.fmu_export import modelica_text, write_ssp
from aero_bayes.laws.fmu_ports import FmuBoundary, Seam
from aero_bayes.laws.law import Law
from aero_bayes.laws.rig_family import RigFamily, Sizes
from aero_bayes.laws.use import Use
from aero_bayes.laws.write import Written
from aero_bayes.ports.port import Port
from aero_bayes.ports.sizes import pace, recorded, signal_size, typical_time, watched_signals
from aero_bayes.simulation import Model


@dataclass(frozen=True)
class FmuFamily(RigFamily):
    """An FMU and its relatives.

    Parameters
    ----------
    base : str
        The name to call it by.
    sources : tuple of Path
        Modelica files whose laws count beside the shipped ones.
    folder : Path
        Where FMUs are kept.
    fmu : Path
    """

    fmu: Path = Path()
    _held: dict[str, float] = field(default_factory=dict, compare=False, repr=False)

    @cached_property
    def inner(self) -> Model:
        return Model.load(self.fmu)

    @cached_property
    def surroundings(self) -> FmuBoundary:
        return FmuBoundary(self.inner, self.laws)

    @cached_property
    def declared(self) -> Declaration:
        """Nothing: what is around an FMU is found."""
        return Declaration()

    @cached_property
    def replaceable_laws(self) -> tuple[Law, ...]:
        """None: an FMU has no replaceable models."""
        return ()

    @cached_property
    def ports(self) -> tuple[Port, ...]:
        return self.surroundings.ports

    def plain(self) -> Model:
        """The FMU itself."""
        return self.inner

    def check(self) -> None:
        """Raise InputError for an FMU that laws cannot be put around, and as for any model."""
        if self.inner.interface != "model exchange":
            raise InputError(f"{self.fmu}: the loop needs Model Exchange; this FMU has co-simulation only")
        super().check()

    def prepare(self, calibration: Calibration, fit: Optimum, open_simulator: OpenSimulator) -> tuple[str, ...]:
        """Every law at every port that it fits."""
        self._held.clear()
        self._held.update(calibration.fixed)
        return super().prepare(calibration, fit, open_simulator)

    def _taken(self) -> set[str]:
        inner = self.inner
        every = (*inner.parameters, *inner.inputs, *inner.outputs, *inner.states)
        return {v.name for v in every} | set(self.surroundings.names.values())

    def _candidates(self, calibration: Calibration) -> Sequence[Candidate]:
        """Of an input that no recording has, only what acts without it."""
        driven = {s.name for e in calibration.experiments for s in e.inputs}
        return [
            c
            for c in candidates(self.ports, self.laws)
            if c.port.kind != "input" or c.port.id in driven or c.law.id == "offset"
        ]

    def _sizes(self, calibration: Calibration, fit: Optimum, open_simulator: OpenSimulator) -> Sizes:
        """As the fit has them; a force is sized by its recording, or by its nominal value."""
        inner = self.inner
        names = {v.name for v in inner.outputs if v.kind == "real"}
        names |= {s for p in self.ports if p.kind == "motion" for s in p.states}
        found = watched_signals(calibration, sorted(names), fit, open_simulator)
        seen = {name: signal_size(parts) or 1.0 for name, parts in found.items()}
        given = {
            v.name: signal_size([s.values for s in recorded(calibration, v.name)]) or v.nominal or 1.0
            for v in inner.inputs
        }
        time = typical_time(calibration, fit)
        sizes: dict[str, Mapping[str, float]] = {}
        for port in self.ports:
            if port.kind == "motion":
                assert port.entrance is not None
                force = given[inner.inputs[port.entrance.equation].name]
                speed, *position = (seen[s] for s in port.states)
                place = (*position, speed * time)[0]
                sizes[port.id] = {"f_n": force, "v_n": speed, "x_n": place, "x_w": place, "t_n": time}
            elif port.kind == "input":
                sizes[port.id] = {"u_n": given[port.id], "w_n": pace(recorded(calibration, port.id), time), "t_n": time}
            else:
                sizes[port.id] = {"u_n": seen[port.id.removeprefix("output_")], "t_n": time}
        return sizes

    def _with(self, uses: Sequence[Use]) -> Model:
        seam = self._seam(uses)
        key = hashlib.sha256(f"{seam!r}{self.inner.sha256}".encode()).hexdigest()[:16]
        out = self.folder / f"{self.title}-offer-{key}.fmu"
        if not out.exists():
            self.folder.mkdir(parents=True, exist_ok=True)
            couple(self.inner, seam, out, self.folder / f"{self.title}-laws-{key}.fmu")
        return Model.load(out)

    def _seam(self, uses: Sequence[Use]) -> Seam:
        return self.surroundings.seam(uses, self.law_models)

    def _write(self, uses: Sequence[Use], values: Mapping[str, float], folder: Path) -> tuple[Written, Model]:
        """``NAME.mo`` and ``NAME.ssp`` for other tools, ``NAME.fmu`` for this one."""
        name = "_".join([self.title, *(u.instance for u in uses)])
        seam, none = self._seam(uses), self._seam(())
        values = {**self._held, **values}
        text = modelica_text(self.inner, seam, uses, values, name)
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{name}.mo"
        with whole_file(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
        laws = self.folder / f"{name}-laws.fmu"
        self.folder.mkdir(parents=True, exist_ok=True)
        couple(self.inner, seam, folder / f"{name}.fmu", laws)
        write_ssp(self.inner, laws, seam, values, folder / f"{name}.ssp")
        before = modelica_text(self.inner, none, (), values, name)
        return Written(name, path, text, unified_diff(before, text, f"{self.title}.mo", path.name)), Model.load(
            folder / f"{name}.fmu"
        )

    def on(self, calibration: Calibration, model: Model) -> Calibration:
        """The calibration on a relative, where a state that is an unread output has another name."""
        there = {s.name for s in model.states}
        names = {s.name: state_name(s.name, [s.name]) for s in self.inner.states if s.name not in there}
        return moved(calibration, model, names)
