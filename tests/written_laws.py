"""Laws at ports by their ids, written into a source and held against the same laws in its flat model."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
from numpy.random import Generator
from small_rigs import Numbers, explicit, rig, somewhere

from aero_bayes.export.flat import FlatModel
from aero_bayes.export.rumoca_front import load_flat
from aero_bayes.laws.candidates import candidates, ports_of
from aero_bayes.laws.compose import Models, compose_laws
from aero_bayes.laws.law import Law
from aero_bayes.laws.use import Use, use_of
from aero_bayes.laws.write import Written, write_law

SIZES = {"f_n": 2.5, "v_n": 1.3, "x_n": 0.8, "u_n": 1.7, "q_n": 2.1, "h_n": 0.9, "d_n": 0.9, "i_n": 1.4, "t_n": 0.3}


def uses_at(flat: FlatModel, laws: Sequence[Law], *ids: str) -> list[Use]:
    """Laws at ports by their ids, all switched on."""
    by_id = {c.id: c for c in candidates(ports_of(flat, laws), laws)}
    taken = {v.name for v in flat.variables}
    uses = []
    for c in (by_id[i] for i in ids):
        sizes = {k: v for k, v in SIZES.items() if k in c.law.sizes}
        on = {p.name: p.value("nominal", {**c.law.sizes, **sizes}) for p in c.law.parameters}
        use = use_of(c.law, c.port, taken, sizes=sizes, values=on, neighbour=c.neighbour)
        taken |= {use.instance, *use.names.values()}
        uses.append(use)
    return uses


def agree(
    model: str, sources: list[Path], uses: Sequence[Use], models: Models, folder: Path, rng: Generator
) -> Written:
    """Write, flatten again, and compare rates and outputs at random points."""
    flat = rig(model, *map(str, sources))
    written = write_law(sources, model, flat, uses, folder)
    composed, again = (
        Numbers(explicit(compose_laws(flat, uses, models))),
        Numbers(explicit(load_flat(written.name, [*sources, written.path]))),
    )
    assert sorted(n.replace("_true", "") for n in again.names()) == sorted(
        n.replace(f"{u.instance}.u", u.port.signals["u"]) if (u := uses[0]).port.via == "output" else n
        for n in composed.names()
    )
    for name in (n for u in uses for n in u.names.values()):
        assert again.b.symbol(name) in again.at
    for _ in range(5):
        point = somewhere(composed.names(), rng)
        other = {n: point[n] if n in point else point[f"{uses[0].instance}.u"] for n in again.names()}
        one, two = composed(point), again(other)
        shared = one.keys() & two.keys()
        assert len(shared) >= len(one) - 1
        assert {k: two[k] for k in shared} == pytest.approx({k: one[k] for k in shared}, rel=1e-11, abs=1e-12)
    return written
