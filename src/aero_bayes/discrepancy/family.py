"""The FMUs of one base model: as it is, with every effect switched off, with probes, with curves, with chosen effects.

Each is built once and kept in a folder under the hash of what it was made from, so that a second run finds it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

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
