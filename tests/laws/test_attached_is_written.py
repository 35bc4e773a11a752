"""The attached model is the written one: every law at every port of models of every kind, several at each place."""

from __future__ import annotations

from pathlib import Path

import pytest
from port_models import MODELS, PortModel
from small_rigs import rig
from written_laws import agree, attached_to, uses_at

from aero_bayes.laws.attach import AlgebraicLoopError, can_be_attached
from aero_bayes.laws.candidates import PlacedLaw, find_candidates, ports_with_laws
from aero_bayes.laws.law_places import LawPlaces

#: Models where laws change at once what they read, and have to be solved with the model.
TOGETHER = ("filter of components", "grounded capacitor")
#: Models where a law acts at once on what another one reads: on a load, or on an output whose derivative is taken. They
#: are solved with the model where they stand together, and attached one by one.
ONE_BY_ONE = ("force between two masses", "each place once")
#: Laws that read a load of which they are a part themselves.
IN_A_LOOP = ("load_friction@strut.s_rel", "load_friction@tyre.s_rel")
REAL = {
    path.parent.name: PortModel("Rig", path.read_text(encoding="utf-8"))
    for path in sorted((Path(__file__).parents[2] / "studies" / "real_rigs").glob("*/Rig.mo"))
}


def at_once(placed_laws: list[PlacedLaw]) -> list[list[PlacedLaw]]:
    """The laws in groups that can stand together: one law on the derivative of each output, before the others there."""
    rated: dict[str, list[PlacedLaw]] = {}
    for placed in placed_laws:
        if placed.law.needs_derivative:
            rated.setdefault(placed.port.id, []).append(placed)
    count = max((len(own) for own in rated.values()), default=1)
    groups = [[own[k] for own in rated.values() if k < len(own)] for k in range(count)]
    return [groups[0] + [p for p in placed_laws if not p.law.needs_derivative], *groups[1:]]


@pytest.mark.parametrize(
    "model",
    [
        *(pytest.param(model, id=name) for name, model in MODELS.items() if name not in TOGETHER),
        *(pytest.param(model, id=name, marks=pytest.mark.long) for name, model in REAL.items()),
    ],
)
def test_every_law_at_every_port_is_written_as_attached(model, laws, blocks, tmp_path, rng):
    sources = model.written_to(tmp_path)
    flat = rig(model.name, *map(str, sources))
    writable = {c.id for c in LawPlaces(model.name, tuple(sources)).candidates_for(None) if not c.twins}
    every = [c.id for c in find_candidates(ports_with_laws(flat, laws), laws)]
    assert model in REAL.values() or writable == set(every)
    kept = (id_ for id_ in every if id_ in writable)
    placed_laws = [p for p in uses_at(flat, laws, *kept, sources=sources) if can_be_attached(p)]
    assert len(placed_laws) > 10
    groups = at_once(placed_laws)
    if model in (MODELS[name] for name in ONE_BY_ONE):
        with pytest.raises(AlgebraicLoopError):
            attached_to(flat, groups[0], blocks, tmp_path / "together")
        alone = [p for p in placed_laws if p.law.needs_derivative or p.law.id == "load_friction"]
        groups = [[p for p in placed_laws if p not in alone], *([p] for p in alone if p.id not in IN_A_LOOP)]
    for group in groups:
        agree(model.name, sources, group, blocks, tmp_path, rng)
