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

from aero_bayes.declared import Declaration
from aero_bayes.errors import InputError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.climb import Optimum
from aero_bayes.estimate.declared import declared_overrides
from aero_bayes.estimate.parameters import Override, Parameter
from aero_bayes.export import (
    Compiler,
    EffectUse,
    ExtendedModel,
    FreeForm,
    declaration_of,
    export_fmu,
    first_compiler,
    write_extension,
)
from aero_bayes.export.library import rig_packages
from aero_bayes.laws.selection import Narrowed
from aero_bayes.physics.catalogue import candidates_of, effect_parameter
from aero_bayes.physics.kin import Basis, Candidate, Extension, Offer, OpenSimulator, moved, rounded
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
        A system that its package declares, such as ``Aero.Systems.OneDof``.
    folder : Path
        Where FMUs and written models are kept.
    narrowed : Narrowed
        Which of the declared effects count.
    sources : tuple of Path
        Folders of packages that are not shipped.
    """

    base: str
    folder: Path
    compiler: Compiler = "auto"
    narrowed: Narrowed = field(default_factory=Narrowed)
    sources: tuple[Path, ...] = ()
    _offered: dict[str, tuple[Candidate, tuple[Parameter, ...]]] = field(
        default_factory=dict, compare=False, repr=False
    )

    @property
    def title(self) -> str:
        return self.base.rpartition(".")[2]

    @cached_property
    def declared(self) -> Declaration:
        """What the package declares."""
        return declaration_of(self.base, self.sources)

    @property
    def effects(self) -> tuple[str, ...]:
        """Ids that count."""
        return tuple(e.id for e in self.declared.effects if self.narrowed.keeps(e.id, e.id, e.port))

    def check(self) -> None:
        """Raise InputError where the engineer's choice names what there is not, or leaves nothing."""
        every = self.declared.catalogue
        self.narrowed.check(every, every, self.declared.ports)
        if not self.effects:
            left = "[loop] effects, exclude, ports and laws leave none"
            raise InputError(f"{self.base}: no effect is left to try; {left}")

    @cached_property
    def library_hash(self) -> str:
        """Hash of the packages that everything is built on."""
        digest = hashlib.sha256()
        for root in (*rig_packages(), *self.sources):
            for path in sorted(p for p in root.rglob("*") if p.suffix in (".mo", ".toml")) if root.is_dir() else [root]:
                digest.update(path.relative_to(root.parent).as_posix().encode() + b"\0" + path.read_bytes())
        return digest.hexdigest()

    def plain(self) -> Model:
        """The base itself."""
        return self._build(self.base, "", ())

    def overrides(self, model: Model) -> Mapping[str, Override]:
        """The declared priors."""
        return declared_overrides(model)

    @property
    def roomy(self) -> bool:
        """One model has them all."""
        return True

    def prepare(self, calibration: Calibration, fit: Optimum, open_simulator: OpenSimulator) -> tuple[str, ...]:
        """Every effect that counts and that the recorded outputs can show."""
        levels = [float(np.abs(s.values).max()) for e in calibration.experiments for s in e.inputs]
        self._offered.clear()
        highest = max(levels, default=self.declared.limits.input or 1.0)
        self._offered.update(candidates_of(self.declared, self.effects, calibration.outputs, highest))
        return tuple(self._offered)

    def groups(self) -> tuple[tuple[str, ...], ...]:
        return (tuple(self._offered),)

    def finer(self) -> Mapping[str, str]:
        return {e.id: e.refines for e in map(self.declared.effect, self._offered) if e.refines}

    def learned(self) -> Mapping[str, str]:
        """None: a declared package has its own curves."""
        return {}

    def basis(self, id_: str) -> Basis:
        """There is none."""
        raise KeyError(id_)

    def offer(self, ids: Collection[str]) -> Offer:
        """The one model that carries every effect switched off."""
        every = self._offered.values()
        parameters = tuple(p for _, own in every for p in own)
        return Offer(self.screening(), parameters, tuple((c, len(own)) for c, own in every))

    def extend(self, ids: Sequence[str], values: Mapping[str, float], folder: Path) -> Extension:
        """The base with chosen effects."""
        of = {id_: self.declared.effect(id_) for id_ in ids}
        uses = [EffectUse(i, {p.name: rounded(values[p.name]) for p in e.parameters}) for i, e in of.items()]
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
        return self.declared.effect(id_).summary

    def diff(self, written: ExtendedModel) -> str:
        """The extended model's file as a diff against one that adds nothing."""
        empty = ["within ;", f'model {written.name} "{self.title}"', f"  extends {self.base};", f"end {written.name};"]
        lines = difflib.unified_diff(
            empty, written.text.splitlines(), fromfile=f"{self.title}.mo", tofile=written.path.name, lineterm="", n=2
        )
        return "\n".join(lines)

    def screening(self) -> Model:
        """The base with every declared effect switched off, and an input at every port."""
        uses = [EffectUse(id_) for id_ in self.declared.catalogue]
        return self._extended(uses, f"{self.title}_screening", probes=True)

    def curve(self, port: str, over: str, knots: int = KNOTS[0]) -> Model:
        """The base with a curve over one state at one port, zero everywhere; its range is a parameter."""
        use = FreeForm(port, over, -1.0, 1.0, (0.0,) * knots, prefix=CURVE_PREFIX)
        return self._extended([use], f"{self.title}_curve_{port}_{over}_{knots}", probes=False)

    def with_effects(self, uses: Sequence[EffectUse | FreeForm], folder: Path) -> tuple[ExtendedModel, Model]:
        """The base with chosen effects, written to ``folder`` as a model of its own, and its FMU."""
        written = write_extension(self.base, uses, folder, sources=self.sources)
        return written, self._build(written.name, written.text, (written.path,))

    def _extended(self, uses: Sequence[EffectUse | FreeForm], name: str, *, probes: bool) -> Model:
        written = write_extension(
            self.base, uses, self.folder / "models", name=name, probes=probes, sources=self.sources
        )
        return self._build(written.name, written.text, (written.path,))

    def _build(self, name: str, text: str, sources: Sequence[Path]) -> Model:
        def made_by(compiler: Compiler) -> Path:
            key = hashlib.sha256(f"{self.library_hash}\0{compiler}\0{name}\0{text}".encode()).hexdigest()[:16]
            out = self.folder / f"{name.rpartition('.')[2]}-{key}.fmu"
            files = [*self.sources, *sources]
            return out if out.exists() else export_fmu(name, out, compiler=compiler, sources=files)

        return Model.load(first_compiler(self.compiler, made_by))
