"""A law with one rounded step by the sign of a speed, such as dry friction, so that its step can be held at a value.

While the speed keeps its sign the law then has no corner, and at rest it is a force of any value between both sides:
the simulator does so (``simulation/native/relay.c``), where the speed is a sum of states."""

from __future__ import annotations

from dataclasses import replace

from aero_bayes.laws.law import Law
from aero_bayes.modelica.causalisation import causalise
from aero_bayes.modelica.codegen import GIVEN, HELD
from aero_bayes.modelica.compose import add_input
from aero_bayes.modelica.equation_system import translate
from aero_bayes.modelica.flat import FlatModel
from aero_bayes.modelica.syntax import Call, Expression, Name, Number, map_children, walk


def step_of(flat: FlatModel, law: Law) -> tuple[Name, Call] | None:
    """Return ``v`` and the rounded step ``tanh(v / v_smooth)`` of a law that has one.

    Its width is final: of the solver's making. One that may be set is part of the law."""
    fitted = {p.name for p in law.parameters}
    fixed = {v.name for v in flat.variables if v.variability == "constant"} - fitted
    found: dict[Call, Name] = {}
    for part in (part for e in flat.equations for tree in (e.left, e.right) for part in walk(tree)):
        match part:
            case Call("tanh", (Call("/", (Name(_, ()) as by, Name(width, ()))),)):
                if width in fixed and by.name not in fixed | fitted:
                    found[part] = by
    if len(found) != 1 or law.kind in ("input", "output", "reading"):
        return None
    ((step, by),) = found.items()
    return by, step


def with_held_step(flat: FlatModel, law: Law) -> FlatModel:
    """Return a law with inputs by which its step is held at a value, as far as it is affine in the step."""
    found = step_of(flat, law)
    if found is None:
        return flat
    held = Name(HELD)
    given = Call("*", (held, Name(GIVEN)))
    step = Call("+", (Call("*", (Call("-", (Number(1.0), held)), found[1])), given))

    def with_step(tree: Expression) -> Expression:
        return step if tree == found[1] else map_children(tree, with_step)

    equations = tuple(replace(e, left=with_step(e.left), right=with_step(e.right)) for e in flat.equations)
    wider = add_input(add_input(replace(flat, equations=equations), HELD), GIVEN)
    solved = causalise(translate(wider))
    b = solved.system.builder
    nodes = [*solved.rates, *(solved.solved.get(v.name, b.zero) for v in flat.variables if v.causality == "output")]
    slopes = (b.derivative(node, b.symbol(GIVEN)) for node in nodes)
    return flat if any(b.symbol(GIVEN) in b.symbols(slope) for slope in slopes) else wider
