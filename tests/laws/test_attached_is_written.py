"""The attached model is the written one: every law at every port of models of every kind, several at each place."""

from __future__ import annotations

from pathlib import Path

import pytest
from port_models import MODELS, PortModel
from small_rigs import rig
from written_laws import agree, uses_at

from aero_bayes.laws.attach import can_be_attached
from aero_bayes.laws.candidates import PlacedLaw, find_candidates, ports_with_laws
from aero_bayes.laws.law_places import LawPlaces

#: Models where laws change at once what they read, and have to be solved with the model.
TOGETHER = ("filter of components", "grounded capacitor")
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
    placed_laws = [p for p in uses_at(flat, laws, *(id_ for id_ in every if id_ in writable)) if can_be_attached(p)]
    assert len(placed_laws) > 10
    for group in at_once(placed_laws):
        agree(model.name, sources, group, blocks, tmp_path, rng)
