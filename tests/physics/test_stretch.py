"""Springs and dampers between two bodies: one port each, what acts there felt by both."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from numpy.random import Generator
from physics_rigs import Numbers, explicit, rig, somewhere
from test_write import uses_at

from aero_bayes.export.expression import evaluate
from aero_bayes.physics.compose import Models, compose_laws
from aero_bayes.physics.find import ports_of
from aero_bayes.physics.laws import Law


def test_a_spring_between_bodies_is_a_motion_and_nothing_is_listed_twice(laws: tuple[Law, ...]) -> None:
    """Not a second port for a mount on the wall, a damper beside another, or a sensor at a body's other end."""
    found = {p.id: p for p in ports_of(rig("Stretch.Absorber"), laws) if p.via not in ("input", "output")}
    assert {id_: p.kind for id_, p in found.items()} == {
        "first.v": "motion", "second.v": "motion", "link.v_rel": "motion",
    }  # fmt: skip
    assert {"coulomb_friction", "cubic_stiffness", "backlash"} <= {*found["link.v_rel"].laws}
    assert found["link.v_rel"].signals == {"v": "link.v_rel", "x": "link.s_rel"}


@pytest.mark.parametrize(("law", "by_hand"), [
    ("cubic_stiffness", lambda k_3, x, v: k_3 * x**3), ("quadratic_drag", lambda c, x, v: c * v * abs(v)),
])  # fmt: skip
def test_a_law_there_acts_on_both_bodies(
    law: str, by_hand: Callable[[float, float, float], float], laws: tuple[Law, ...], models: Models, rng: Generator
) -> None:
    flat = rig("Stretch.Absorber")
    use = uses_at(flat, laws, f"{law}@link.v_rel")[0]
    with_law = Numbers(explicit(compose_laws(flat, [use], models)))
    (name,) = use.names.values()
    size = with_law.at[with_law.b.symbol(name)]
    for _ in range(5):
        at = somewhere(with_law.names(), rng)
        solved = with_law.model.solved
        place = {**with_law.at, **{with_law.b.symbol(n): x for n, x in at.items()}}
        wanted = ["first.s", "first.v", "second.s", "second.v", "first.a", "second.a"]
        nodes = [solved.get(n, with_law.b.symbol(n)) for n in wanted]
        s1, v1, s2, v2, a1, a2 = evaluate(nodes, place)
        x, v = s2 - s1 - 0.05, v2 - v1
        between = 6.0 * x + 0.3 * v + by_hand(size, x, v)
        mount = 20.0 * (s1 - 0.05) + 0.5 * v1
        assert a1 == pytest.approx((at["u"] - mount + between) / 2.0, rel=1e-9)
        assert a2 == pytest.approx(-between, rel=1e-9)
