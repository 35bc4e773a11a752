"""Any Modelica model and its relatives: laws of libraries at the ports that are found in it."""

from __future__ import annotations

import hashlib
import itertools
import math
import tempfile
import zipfile
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from xml.etree import ElementTree

from aero_bayes.errors import InputError
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.climb import Optimum
from aero_bayes.estimate.parameters import Override, Parameter
from aero_bayes.export.compose import TRUE
from aero_bayes.export.embedded import export_flat
from aero_bayes.export.flat import FlatModel
from aero_bayes.export.library import declared_members
from aero_bayes.export.rumoca_front import load_flat
from aero_bayes.laws.candidates import Candidate as Trial
from aero_bayes.laws.candidates import candidates, ports_of
from aero_bayes.laws.compose import Models, compose_laws, law_models
from aero_bayes.laws.law import Law, general_laws, laws_of
from aero_bayes.laws.learned_curve import basis_of
from aero_bayes.laws.model_sources import names_taken
from aero_bayes.laws.selection import Narrowed
from aero_bayes.laws.use import Use, use_of
from aero_bayes.laws.write import Written, write_law
from aero_bayes.physics.kin import Basis, Candidate, Extension, Offer, OpenSimulator, magnitude, moved, rounded
from aero_bayes.ports.equal_variables import structure_of
from aero_bayes.ports.port import Port
from aero_bayes.ports.sizes import port_sizes
from aero_bayes.simulation import Model

#: Magnitudes to start from, as shares of what is typical: of a law that has a shape beside it, and of one that has
#: not, which may act only beyond a threshold that a coarse grid steps over.
SIZES, SIZES_ALONE = (1.0, 0.2, 5.0), (1.0, 0.1, 0.3, 0.6, 0.75, 0.8, 0.84, 0.9, 1.2, 1.6, 2.5, 5.0)
#: Levels at which a law may set in, as shares of the typical one, where its bounds are less than a factor apart.
LEVELS, NARROW = (1.0, 0.85, 0.65, 0.4, 1.1), 30.0
#: Sizes of ports by their ids.
Sizes = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True)
class RigFamily:
    """A model of the user's own.

    Parameters
    ----------
    base : str
        Name of a Modelica class.
    sources : tuple of Path
        Files and package folders that it is loaded from; laws that stand in them count beside the shipped ones.
    folder : Path
        Where FMUs are kept.
    narrowed : Narrowed
    """

    base: str
    sources: tuple[Path, ...]
    folder: Path
    libraries: tuple[Path, ...] = ()
    narrowed: Narrowed = field(default_factory=Narrowed)
    _uses: dict[str, Use] = field(default_factory=dict, compare=False, repr=False)
    _read: dict[str, str] = field(default_factory=dict, compare=False, repr=False)

    @property
    def title(self) -> str:
        return self.base.rpartition(".")[2]

    @cached_property
    def flat(self) -> FlatModel:
        return load_flat(self.base, self.sources, self.libraries)

    @cached_property
    def laws(self) -> tuple[Law, ...]:
        """The shipped laws, and those in the user's sources."""
        return (*general_laws(), *laws_of(self.sources))

    @cached_property
    def ports(self) -> tuple[Port, ...]:
        return ports_of(self.flat, self.laws)

    @cached_property
    def law_models(self) -> Models:
        return law_models(self.laws)

    def plain(self) -> Model:
        """The model itself."""
        return self._export(self.flat, "plain")

    def overrides(self, model: Model) -> Mapping[str, Override]:
        """Nothing beside what the model declares."""
        return {}

    @property
    def roomy(self) -> bool:
        """Laws that are off are simulated all the same."""
        return False

    def check(self) -> None:
        """Raise InputError where the engineer's choice names what there is not."""
        ids = [c.id for c in candidates(self.ports, self.laws)]
        self.narrowed.check(ids, [law.id for law in self.laws], [p.id for p in self.ports])

    def prepare(self, calibration: Calibration, fit: Optimum, open_simulator: OpenSimulator) -> tuple[str, ...]:
        """Every law at every port that it fits."""
        every = [c for c in self._candidates(calibration) if self.narrowed.keeps(c.id, c.law.id, c.port.id)]
        if not every:
            raise InputError(f"{self.base}: no law is left to try; [loop] exclude, ports and laws leave none")
        sizes = self._sizes(calibration, fit, open_simulator)
        taken = self._taken()
        self._uses.clear()
        for c in every:
            use = use_of(c.law, c.port, taken, sizes=sizes.get(c.port.id, {}), neighbour=c.neighbour)
            taken |= {use.instance, *use.names.values()}
            self._uses[use.id] = use
            self._read.update(_read_by(use))
        return tuple(self._uses)

    def _candidates(self, calibration: Calibration) -> Sequence[Trial]:
        return self.tried()

    def tried(self) -> tuple[Trial, ...]:
        """Every law at every port where the source has a place for one."""
        every = candidates(self.ports, self.laws)
        edited = {c.port.id: c for c in every if c.port.via in ("equation", "signal")}.values()
        barred = {c.port.id for c in edited if not self._can_be_written(c)}
        return tuple(c for c in every if c.port.id not in barred)

    def _can_be_written(self, c: Trial) -> bool:
        use = use_of(c.law, c.port, self._taken(), sizes={}, neighbour=c.neighbour)
        try:
            with tempfile.TemporaryDirectory() as folder:
                write_law(self.sources, self.base, self.flat, [use], folder)
        except InputError:
            return False
        return True

    def _sizes(self, calibration: Calibration, fit: Optimum, open_simulator: OpenSimulator) -> Sizes:
        return port_sizes(self.flat, self.ports, calibration, fit, open_simulator)

    def _taken(self) -> set[str]:
        """Names that the model has."""
        return names_taken(self.flat, self.sources)

    def groups(self) -> tuple[tuple[str, ...], ...]:
        """Laws without states together; those with states, which slow a simulation down, by port; curves last."""
        curves, finer = self.learned(), self.finer()
        still = tuple(id_ for id_, use in self._uses.items() if not use.law.moves and id_ not in curves)
        by_port: dict[str, list[str]] = {}
        for id_, use in self._uses.items():
            if use.law.moves:
                by_port.setdefault(use.port.id, []).append(id_)
        tiers = (tuple(c for c in curves if (c in finer) is fine) for fine in (False, True))
        return tuple(g for g in (still, *(tuple(ids) for ids in by_port.values()), *tiers) if g)

    def finer(self) -> Mapping[str, str]:
        """Laws that refine one at the same port."""
        found = {id_: f"{use.law.refines}@{use.port.id}" for id_, use in self._uses.items() if use.law.refines}
        return {id_: coarse for id_, coarse in found.items() if coarse in self._uses}

    def learned(self) -> Mapping[str, str]:
        """Curves that stand for no law, and over which signal each is learned."""
        return {id_: use.port.signals.get(use.law.learned, use.port.id) for id_, use in self._uses.items()
                if use.law.learned}  # fmt: skip

    def basis(self, id_: str) -> Basis:
        """Of a curve that is learned."""
        return basis_of(self._uses[id_], self.law_models)

    def offer(self, ids: Collection[str]) -> Offer:
        """The model with some laws, switched off."""
        uses = self._ordered(id_ for id_ in self._uses if id_ in ids)
        model = self._with(uses)
        own = [(Candidate(u.id, u.port.id, _starts(u), vanishing=_vanishing(u)), _parameters(u)) for u in uses]
        return Offer(model, tuple(p for _, ps in own for p in ps), tuple((c, len(ps)) for c, ps in own))

    def _with(self, uses: Sequence[Use]) -> Model:
        return self._export(compose_laws(self.flat, uses, self.law_models), "offer")

    def _ordered(self, ids: Iterable[str]) -> list[Use]:
        """Uses in the order in which they are composed: laws that need the rate of a reading are the innermost."""
        return sorted((self._uses[id_] for id_ in ids), key=lambda u: not u.law.takes_rate)

    def extend(self, ids: Sequence[str], values: Mapping[str, float], folder: Path) -> Extension:
        """The model with chosen laws, written into a copy of its source."""
        taken = self._taken()
        uses: list[Use] = []
        names: dict[str, tuple[tuple[str, str], ...]] = {}
        for old in self._ordered(ids):
            own = {p.name: rounded(values[old.names[p.name]], 6) for p in old.parameters()}
            use = use_of(old.law, old.port, taken, sizes=old.sizes, values=own, neighbour=old.neighbour)
            taken |= {use.instance, *use.names.values()}
            uses.append(use)
            self._read.update(_read_by(use))
            names[old.id] = tuple((old.names[p.name], use.names[p.name]) for p in old.parameters())
        written, model = self._write(uses, values, folder)
        parameters = tuple(p for use in uses for p in _parameters(use))
        return Extension(
            written.name, written.path, written.text, written.diff, model, parameters, names, {id_: {} for id_ in ids}
        )

    def _write(self, uses: Sequence[Use], values: Mapping[str, float], folder: Path) -> tuple[Written, Model]:
        """The written model and its FMU; ``values`` are those of the fit, by the names of the offers."""
        written = write_law(self.sources, self.base, self.flat, uses, folder)
        flat = load_flat(written.name, (*self.sources, written.path), self.libraries)
        return written, self._export(flat, written.name)

    def on(self, calibration: Calibration, model: Model) -> Calibration:
        """The calibration on a relative: a state takes the name of what it equals there."""
        structure = structure_of(self.flat)
        there: dict[str, str] = {}
        for s in model.states:
            # what an output's law reads is what the output was
            unread = s.name.removesuffix(TRUE).replace(f"{TRUE}[", "[")
            was = self._read.get(s.name, unread if s.name not in self._aliases else s.name)
            there.setdefault(self._aliases.get(was, was), s.name)
            if was in structure.variables:
                there.setdefault(structure.of(was), s.name)
        known = {s.name: structure.of(s.name) for s in calibration.model.states if s.name in structure.variables}
        names = {s: there.get(s, there.get(same, s)) for s, same in known.items()}
        return moved(calibration, model, names)

    @cached_property
    def _aliases(self) -> dict[str, str]:
        """A state of the model by the name of each variable that equals it."""
        model = self.plain()
        with zipfile.ZipFile(model.path) as archive:
            root = ElementTree.fromstring(archive.read("modelDescription.xml"))
        states = {str(s.value_reference): s.name for s in model.states}
        variables = [(v.get("name", ""), v.get("valueReference", "")) for v in root.iter("ScalarVariable")]
        return {name: states[reference] for name, reference in variables if reference in states}

    def summary(self, id_: str) -> str:
        """A law in words."""
        use = self._uses[id_]
        return f"{use.law.description[:1].lower()}{use.law.description[1:]} at {use.port.id}"

    def _export(self, flat: FlatModel, what: str) -> Model:
        """The FMU of a flat model, kept under the hash of what it was made from."""
        key = hashlib.sha256(repr(flat).encode()).hexdigest()[:16]
        out = self.folder / f"{self.title}-{what}-{key}.fmu"
        if not out.exists():
            self.folder.mkdir(parents=True, exist_ok=True)
            export_flat(flat, out, members=declared_members(self.base, self.sources))
        return Model.load(out)


def _read_by(use: Use) -> dict[str, str]:
    """The output that a law stands before, by the law's own name for its quantity."""
    return {f"{use.instance}.u": use.port.signals["u"]} if use.port.via == "output" else {}


def _parameters(use: Use) -> list[Parameter]:
    """Columns of a law, the switch first."""
    found = []
    for p in use.parameters():
        limits = use.limits(p)
        bounds = limits.get("min", -1e3 * limits["nominal"]), limits.get("max", 1e3 * limits["nominal"])
        default = p.value("default", use.all_sizes)
        about = f"{p.description} at {use.port.id}"
        found.append(magnitude(use.names[p.name], use.unit(p), about, bounds, limits["nominal"], default))
    return found


def _vanishing(use: Use) -> tuple[int, ...]:
    """Columns of the shape with which a finer law becomes a coarser one as it goes to 0."""
    return tuple(k for k, p in enumerate(use.parameters()) if p.name == use.law.vanishing)


def _starts(use: Use) -> tuple[tuple[float, ...], ...]:
    """Values worth starting from: magnitudes, of both signs where they mean something, and shapes."""
    if use.law.learned:
        return ()
    choices: list[Collection[float]] = []
    parameters = list(use.parameters())
    for k, p in enumerate(parameters):
        limits = use.limits(p)
        low, high = limits.get("min", -math.inf), limits.get("max", math.inf)
        scale = limits["nominal"]
        if k == 0:
            static = len(parameters) == 1 and low >= 0.0 and not use.law.moves
            sizes = [m * scale for m in (SIZES_ALONE if static or use.law.threshold else SIZES)]
            values = [s for s in sizes if s <= high] + ([-s for s in sizes if -s >= low] if low < 0.0 else [])
        elif low > 0.0 and high < NARROW * low:
            values = [m * scale for m in LEVELS if low < m * scale < high]
        elif low > 0.0:
            values = [scale, math.sqrt(scale * low), math.sqrt(scale * high)]
        else:
            values = [scale] if low >= 0.0 else [scale, -scale]
        choices.append(values)
    return tuple(itertools.product(*choices))
