"""Laws at ports by their ids, written into a source and held against the same laws in its flat model."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
from numpy.random import Generator
from small_rigs import Numbers, explicit, rig, somewhere

from aero_bayes.modelica.flat import FlatModel
from aero_bayes.modelica.rumoca_front import load_flat
from aero_bayes.structure.candidates import PlacedLaw, find_candidates, place_law, ports_with_laws
from aero_bayes.structure.compose import LawModels, compose_laws
from aero_bayes.structure.law import Law
from aero_bayes.structure.write_model import WrittenModel, write_laws

SIZES = {"f_n": 2.5, "v_n": 1.3, "x_n": 0.8, "u_n": 1.7, "q_n": 2.1, "h_n": 0.9, "d_n": 0.9, "i_n": 1.4, "t_n": 0.3}


def uses_at(flat: FlatModel, laws: Sequence[Law], *ids: str) -> list[PlacedLaw]:
    """Laws at ports by their ids, all switched on."""
    by_id = {c.id: c for c in find_candidates(ports_with_laws(flat, laws), laws)}
    taken = {v.name for v in flat.variables}
    placed_laws = []
    for c in (by_id[i] for i in ids):
        sizes = {k: v for k, v in SIZES.items() if k in c.law.nominals}
        on = {p.name: p.value("nominal", {**c.law.nominals, **sizes}) for p in c.law.parameters}
        placed = place_law(c, taken, nominals=sizes, values=on)
        taken |= {placed.instance, *placed.names.values()}
        placed_laws.append(placed)
    return placed_laws


def agree(
    model: str, sources: list[Path], placed_laws: Sequence[PlacedLaw], models: LawModels, folder: Path, rng: Generator
) -> WrittenModel:
    """Write, flatten again, and compare rates and outputs at random points."""
    flat = rig(model, *map(str, sources))
    written = write_laws(sources, model, flat, placed_laws, folder)
    composed, again = (
        Numbers(explicit(compose_laws(flat, placed_laws, models))),
        Numbers(explicit(load_flat(written.name, [*sources, written.path]))),
    )
    assert sorted(n.replace("_true", "") for n in again.names()) == sorted(
        n.replace(f"{u.instance}.u", u.port.signals["u"]) if (u := placed_laws[0]).port.attachment == "output" else n
        for n in composed.names()
    )
    for name in (n for u in placed_laws for n in u.names.values()):
        assert again.b.symbol(name) in again.at
    for _ in range(5):
        point = somewhere(composed.names(), rng)
        other = {n: point[n] if n in point else point[f"{placed_laws[0].instance}.u"] for n in again.names()}
        one, two = composed(point), again(other)
        shared = one.keys() & two.keys()
        assert len(shared) >= len(one) - 1
        assert {k: two[k] for k in shared} == pytest.approx({k: one[k] for k in shared}, rel=1e-11, abs=1e-12)
    return written
