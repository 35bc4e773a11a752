"""Laws at ports by their ids, written into a source and held against the same laws attached to it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from export_driver import driven
from numpy.random import Generator
from small_rigs import Numbers, explicit, rig, somewhere

from aero_bayes.laws.aliases import alias_structure
from aero_bayes.laws.attach import LawBlocks, attached
from aero_bayes.laws.candidates import PlacedLaw, find_candidates, place_law, ports_with_laws
from aero_bayes.laws.coupled_fmu import couple
from aero_bayes.laws.law import Law
from aero_bayes.laws.probed_model import probed_model
from aero_bayes.laws.write_model import WrittenModel, reserved_names, write_laws
from aero_bayes.modelica.embedded import export_flat
from aero_bayes.modelica.flat import FlatModel
from aero_bayes.modelica.rumoca_front import load_flat
from aero_bayes.simulation.model import Model

SIZES = {"f_n": 2.5, "v_n": 1.3, "x_n": 0.8, "u_n": 1.7, "q_n": 2.1, "h_n": 0.9, "d_n": 0.9, "i_n": 1.4, "t_n": 0.3}


def uses_at(flat: FlatModel, laws: Sequence[Law], *ids: str, sources: Sequence[Path] = ()) -> list[PlacedLaw]:
    """Laws at ports by their ids, all switched on."""
    by_id = {c.id: c for c in find_candidates(ports_with_laws(flat, laws), laws)}
    taken = reserved_names(flat, sources)
    placed_laws = []
    for c in (by_id[i] for i in ids):
        sizes = {k: v for k, v in SIZES.items() if k in c.law.nominals}
        on = {p.name: p.value("nominal", {**c.law.nominals, **sizes}) for p in c.law.parameters}
        placed = place_law(c, taken, nominals=sizes, values=on)
        taken |= {placed.instance, *placed.names.values()}
        placed_laws.append(placed)
    return placed_laws


def written_flat(model: str, sources: Sequence[Path], placed_laws: Sequence[PlacedLaw], folder: Path) -> FlatModel:
    """The flat model of the written one."""
    written = write_laws(sources, model, rig(model, *map(str, sources)), placed_laws, folder)
    return load_flat(written.name, [*sources, written.path])


def attached_to(flat: FlatModel, placed_laws: Sequence[PlacedLaw], blocks: LawBlocks, folder: Path) -> Model:
    """The model with laws attached. Raises AlgebraicLoopError where they have to be compiled with it."""
    folder.mkdir(parents=True, exist_ok=True)
    base = Model.load(export_flat(flat, folder / "base.fmu"))
    opened = probed_model(base, placed_laws, flat, lambda wider: Model.load(export_flat(wider, folder / "open.fmu")))
    couple(attached(opened, placed_laws, blocks), folder / "attached.fmu")
    return Model.load(folder / "attached.fmu")


def agree(
    model: str, sources: list[Path], placed_laws: Sequence[PlacedLaw], blocks: LawBlocks, folder: Path, rng: Generator
) -> WrittenModel:
    """Write, flatten again, and compare rates and outputs at random points with those of the laws attached."""
    flat = rig(model, *map(str, sources))
    written = write_laws(sources, model, flat, placed_laws, folder, f"{model.rpartition('.')[2]}WithLaws")
    again = Numbers(explicit(load_flat(written.name, [*sources, written.path])))
    for name in (n for u in placed_laws for n in u.names.values()):
        assert again.b.symbol(name) in again.at
    structure = alias_structure(flat)
    # a connector that is read stays one where a law acts on it: then its true value is an output too
    outputs = Numbers(explicit(flat)).outputs
    assert set(again.outputs) >= set(outputs)
    read = {f"{u.instance}.u": str(u.port.signals["u"]) for u in placed_laws if u.port.attachment == "output"}

    def plain(state: str) -> str:
        """What the base calls a state and all that equals it: one on which a law acts has another name."""
        name = read.get(state, state.removesuffix("_unread").removesuffix("_true").replace("_true[", "["))
        return structure.of(name) if name in structure.variables else name

    with driven(attached_to(flat, placed_laws, blocks, folder / "attached").path) as fmu:
        assert sorted(map(plain, fmu.states)) == sorted(map(plain, again.model.states))
        fmu.begin()
        for _ in range(5):
            point = somewhere(again.names(), rng)
            by_state = {plain(s): point[s] for s in again.model.states}
            fmu.set_all({n: point[n] for n in again.names() if n not in again.model.states})
            rates = fmu.rhs(np.array([by_state[plain(s)] for s in fmu.states]))
            found = {plain(s): rate for s, rate in zip(fmu.states, rates, strict=True)}
            expected = again(point)
            moving = {plain(s): expected[f"der({s})"] for s in again.model.states}
            assert found == pytest.approx(moving, rel=1e-9, abs=1e-11)
            shown = dict(zip(outputs, fmu.get(*outputs), strict=True))
            assert shown == pytest.approx({n: expected[n] for n in outputs}, rel=1e-9, abs=1e-11)
    return written
