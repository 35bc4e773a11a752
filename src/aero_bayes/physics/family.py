"""The FMUs of one base model: as it is, with every effect switched off, with probes, with curves, with chosen effects.

Each is built once and kept in a folder under the hash of what it was made from, so that a second run finds it.
"""

from __future__ import annotations

import difflib
import hashlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from aero_bayes.estimate.aero import aero_overrides
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.climb import Optimum
from aero_bayes.estimate.parameters import Override, Parameter
from aero_bayes.export import (
    CATALOGUE,
    Compiler,
    EffectUse,
    ExtendedModel,
    FreeForm,
    Port,
    export_fmu,
    first_compiler,
    modelica_root,
    write_extension,
)
from aero_bayes.physics.catalogue import candidates_of, effect_parameter
from aero_bayes.physics.kin import Candidate, Extension, Offer, OpenSimulator, moved
from aero_bayes.simulation import Model

#: Knots that a learned curve may have, coarsest first.
KNOTS = (7, 15, 31, 63)
#: Its values are the parameters ``c_1``, ``c_2``, ...
CURVE_PREFIX = "c"


@dataclass(frozen=True)
class ModelFamily:
    """A base system and where its relatives are built.

    Parameters
    ----------
    base : str
        A system with slots, such as ``Aero.Systems.OneDof``.
    folder : Path
        Where FMUs and written models are kept.
    """

    base: str
    folder: Path
    compiler: Compiler = "auto"
    effects: tuple[str, ...] = tuple(CATALOGUE)
    _offered: dict[str, tuple[Candidate, tuple[Parameter, ...]]] = field(
        default_factory=dict, compare=False, repr=False
    )

    @property
    def title(self) -> str:
        return self.base.rpartition(".")[2]

    @cached_property
    def library_hash(self) -> str:
        """Hash of the Modelica package that everything is built on."""
        digest = hashlib.sha256()
        root = modelica_root()
        for path in sorted(root.rglob("*.mo")):
            digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
        return digest.hexdigest()

    def plain(self) -> Model:
        """The base itself."""
        return self._build(self.base, "", ())

    def overrides(self, model: Model) -> Mapping[str, Override]:
        """The AERO's priors."""
        return aero_overrides(model)

    @property
    def roomy(self) -> bool:
        """One model has them all."""
        return True

    def prepare(self, calibration: Calibration, fit: Optimum, open_simulator: OpenSimulator) -> tuple[str, ...]:
        """Every effect of the catalogue that the recorded outputs can show."""
        levels = [float(np.abs(s.values).max()) for e in calibration.experiments for s in e.inputs]
        self._offered.clear()
        self._offered.update(candidates_of(self.effects, calibration.outputs, max(levels, default=24.0)))
        return tuple(self._offered)

    def groups(self) -> tuple[tuple[str, ...], ...]:
        return (tuple(self._offered),)

    def finer(self) -> Mapping[str, str]:
        return {id_: CATALOGUE[id_].refines for id_ in self._offered if CATALOGUE[id_].refines}

    def offer(self, ids: Collection[str]) -> Offer:
        """The one model that carries every effect switched off."""
        every = self._offered.values()
        parameters = tuple(p for _, own in every for p in own)
        return Offer(self.screening(), parameters, tuple((c, len(own)) for c, own in every))

    def extend(self, ids: Sequence[str], values: Mapping[str, float], folder: Path) -> Extension:
        """The base with chosen effects."""
        of = {id_: CATALOGUE[id_] for id_ in ids}
        uses = [EffectUse(i, {p.name: _significant(values[p.name]) for p in e.parameters}) for i, e in of.items()]
        written, model = self.with_effects(uses, folder)
        return Extension(
            written.name, written.path, written.text, self.diff(written), model,
            tuple(effect_parameter(p) for e in of.values() for p in e.parameters),
            {i: tuple((p.name, p.name) for p in e.parameters) for i, e in of.items()},
            {i: e.widths for i, e in of.items()},
        )  # fmt: skip

    def on(self, calibration: Calibration, model: Model) -> Calibration:
        """The calibration on a relative: a state that an output names there may go by its component's name here."""
        there = {s.name for s in model.states}
        names: dict[str, str] = {}
        for state in calibration.model.states:
            if state.name not in there:
                tails = [n for n in there if n.rpartition(".")[2] == state.name]
                names |= {state.name: tails[0]} if len(tails) == 1 else {}
        return moved(calibration, model, names)

    def summary(self, id_: str) -> str:
        """An effect in words."""
        return CATALOGUE[id_].summary

    def diff(self, written: ExtendedModel) -> str:
        """The extended model's file as a diff against one that adds nothing."""
        empty = ["within ;", f'model {written.name} "{self.title}"', f"  extends {self.base};", f"end {written.name};"]
        lines = difflib.unified_diff(
            empty, written.text.splitlines(), fromfile=f"{self.title}.mo", tofile=written.path.name, lineterm="", n=2
        )
        return "\n".join(lines)

    def screening(self) -> Model:
        """The base with every effect of the catalogue switched off, and an input at every port."""
        return self._extended([EffectUse(id_) for id_ in CATALOGUE], f"{self.title}_screening", probes=True)

    def curve(self, port: Port, over: str, knots: int = KNOTS[0]) -> Model:
        """The base with a curve over one state at one port, zero everywhere; its range is a parameter."""
        use = FreeForm(port, over, -1.0, 1.0, (0.0,) * knots, prefix=CURVE_PREFIX)
        return self._extended([use], f"{self.title}_curve_{port}_{over}_{knots}", probes=False)

    def with_effects(self, uses: Sequence[EffectUse | FreeForm], folder: Path) -> tuple[ExtendedModel, Model]:
        """The base with chosen effects, written to ``folder`` as a model of its own, and its FMU."""
        written = write_extension(self.base, uses, folder)
        return written, self._build(written.name, written.text, (written.path,))

    def _extended(self, uses: Sequence[EffectUse | FreeForm], name: str, *, probes: bool) -> Model:
        written = write_extension(self.base, uses, self.folder / "models", name=name, probes=probes)
        return self._build(written.name, written.text, (written.path,))

    def _build(self, name: str, text: str, sources: Sequence[Path]) -> Model:
        def made_by(compiler: Compiler) -> Path:
            key = hashlib.sha256(f"{self.library_hash}\0{compiler}\0{name}\0{text}".encode()).hexdigest()[:16]
            out = self.folder / f"{name.rpartition('.')[2]}-{key}.fmu"
            return out if out.exists() else export_fmu(name, out, compiler=compiler, sources=list(sources))

        return Model.load(first_compiler(self.compiler, made_by))


def _significant(value: float) -> float:
    return float(f"{value:.4g}")
