"""Explicit model -> C: one structure, lazily evaluated functions, exact Jacobians.

Expressions of parameters alone are computed when a parameter changes and kept (``m->k``); the rest is straight-line
code over local variables. The FMI functions around it are in ``native/fmi2.c``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from aero_bayes.export.algebraic_loops import AlgebraicLoop
from aero_bayes.export.c_functions import (
    StoredValue,
    assertion_function,
    c_string,
    columns_function,
    loop_function,
    reinit_function,
    start_function,
    store_function,
)
from aero_bayes.export.causalisation import ExplicitModel
from aero_bayes.export.equation_system import ScalarVariable
from aero_bayes.export.expression import Builder, Node, evaluate_nodes
from aero_bayes.export.lane_functions import LaneEquations, lane_functions
from aero_bayes.export.layout import VariableLayout
from aero_bayes.export.parameter_stage import ParameterStage
from aero_bayes.export.switching_surfaces import SwitchingModel


class _Memory:
    """Groups of values behind one another, in the order of ``enum Group`` of native/model.h."""

    def __init__(self) -> None:
        self.size = 0
        self.at: dict[str, int] = {}

    def add(self, name: str, count: int) -> None:
        self.at[name] = self.size
        self.size += count

    def place(self, group: str, k: int) -> str:
        return f"m->data[{self.at[group] + k}]"


def generate(switching: SwitchingModel, layout: VariableLayout, guid: str, *, candidates: bool = False) -> str:
    """The complete C source of one model; native/fmi2.c is linked to it.

    It has the equations for several parameter vectors at a time too, where the model has neither algebraic loops nor
    events. With ``candidates`` not these: most of its laws are switched off, so that slow functions which count times
    zero are not called, and derivatives by each parameter are a function of their own.
    """
    model, surfaces = switching.model, switching.surfaces
    b = model.system.builder
    events = model.discrete
    nx, nu, np_ = len(layout.states), len(layout.inputs), len(layout.parameters)
    nq, ny = len(layout.dependent), len(layout.outputs)
    states = [b.symbol(p) for p in layout.state_paths]
    inputs = [b.symbol(v.name) for v in layout.inputs]
    parameters = [b.symbol(v.name) for v in layout.parameters]
    unknowns = [u for loop in model.loops for u in loop.unknowns]
    steps = sorted(events.updates, key=lambda s: s.name.startswith("when#"))
    stage = ParameterStage(b, frozenset(parameters))
    defaults = {
        p: evaluate_nodes([v.binding], {})[0] for p, v in zip(parameters, layout.parameters, strict=True) if v.binding
    }
    # parameters of inner components that nothing shows keep their value
    hidden: dict[Node, Node] = {
        b.symbol(v.name): v.binding
        for v in model.system.parameters
        if v.binding is not None and v.binding.op == "const" and b.symbol(v.name) not in defaults
    }
    memo = dict(hidden)

    def prepare(nodes: Iterable[Node]) -> list[Node]:
        return [stage.reciprocal(b.substitute(n, memo)) for n in nodes]

    rates = prepare(model.rates)
    outputs = prepare(model.solved[v.name] for v in layout.outputs)
    dependent = prepare(v.binding for v in layout.dependent if v.binding is not None)
    starts = prepare(model.starts)
    loops = [prepare(loop.residuals) for loop in model.loops]
    flat_loops = [r for loop in loops for r in loop]
    rows = [*rates, *outputs, *dependent]
    nw, nrow, moving = len(unknowns), len(rows), [*states, *inputs]

    memory = _Memory()
    memory.add("R", layout.first_output + ny)
    memory.add("K", 0)  # the size is known once all expressions are
    leaves = {model.system.time: "m->time"}
    sizes = {
        "W": nw, "D": len(steps), "PRE": len(steps), "REL": len(events.relations), "ROUND": len(events.roundings),
        "SAMPLE": len(events.samplings), "LAST": len(events.samplings), "INITIAL": 1, "STARTED": nx,
        "JX": nrow * (nx + nu), "JP": nrow * np_, "WANTED": np_,
        "JW": nrow * nw, "FW": nw * nw, "FX": nw * (nx + nu), "FP": nw * np_,
        "DIFF": len(events.relations) + len(events.roundings), "TICK": 2 * len(events.samplings),
        "DUE": len(events.relations), "SLOPE": len(events.relations),
        "START": len(model.initial.unknowns) if model.initial is not None else 0,
        **_surface_sizes(len(surfaces), nrow, nx, nu, np_),
    }  # fmt: skip
    for name, size in sizes.items():
        memory.add(name, size)
    memory.at["K"] = memory.size
    values = [
        ("R", 0, states), ("R", 2 * nx, inputs), ("R", layout.first_parameter, parameters), ("W", 0, unknowns),
        ("D", 0, steps), ("PRE", 0, [b.symbol(f"pre({s.name})") for s in steps]),
        ("REL", 0, [r.symbol for r in events.relations]), ("ROUND", 0, [r.symbol for r in events.roundings]),
        ("SAMPLE", 0, [s.symbol for s in events.samplings]), ("INITIAL", 0, [b.symbol("initial()")]),
    ]  # fmt: skip
    for group, first, symbols in values:
        leaves |= {s: memory.place(group, first + i) for i, s in enumerate(symbols)}

    def targets(group: str, nodes: Sequence[Node], first: int = 0) -> list[StoredValue]:
        return [StoredValue(memory.place(group, first + i), n) for i, n in enumerate(nodes)]

    def jacobian(group: str, of: Sequence[Node], by: Sequence[Node]) -> list[StoredValue]:
        return _jacobian(b, of, by, stage, memory.at[group])

    leaves |= {s: memory.place("R", nx + i) for i, s in enumerate(switching.rates)}
    rises = prepare(s.rise for s in surfaces)
    differences = prepare(r.difference for r in events.relations)
    instants = {i: t for i, r in enumerate(events.relations) if (t := model.time_of_change(r.difference)) is not None}
    columns = [_jacobian(b, rows, [p], stage, memory.at["JP"] + j * nrow) for j, p in enumerate(parameters)]
    groups = {
        "dx": targets("R", rates, nx),
        "y": targets("R", outputs, layout.first_output),
        "jx": jacobian("JX", rows, moving),
        "jp": [t for column in columns for t in column],
        "jw": [
            *jacobian("JW", rows, unknowns),
            *jacobian("FW", flat_loops, unknowns),
            *jacobian("FX", flat_loops, moving),
        ],
        "fp": jacobian("FP", flat_loops, parameters),
        "discrete": targets("D", prepare(events.updates[s] for s in steps)),
        "watch": targets("DIFF", [*differences, *prepare(r.argument for r in events.roundings)]),
        "times": [
            *targets("TICK", prepare(x for s in events.samplings for x in (s.start, s.interval))),
            *(StoredValue(memory.place("DUE", i), prepare([t[0]])[0]) for i, t in instants.items()),
            *(StoredValue(memory.place("SLOPE", i), prepare([t[1]])[0]) for i, t in instants.items()),
        ],
        "rise": targets("RISE", rises),
        "rise_slopes": [
            *jacobian("RISE_RATE", rises, switching.rates),
            *jacobian("RISE_X", rises, moving),
            *jacobian("RISE_P", rises, parameters),
        ],
    }
    reinits = prepare(x for r in events.reinits for x in (r.active, r.value))
    assertions = prepare(c for c, _ in events.assertions)
    loop_rows = _loop_targets(b, model.loops, loops, stage)
    saved = stage.to_store([t.node for g in (*groups.values(), *loop_rows) for t in g] + reinits + assertions)
    kept = {n: memory.place("K", i) for i, n in enumerate(saved)}
    memory.size += len(kept)
    early = [StoredValue(place, n) for n, place in kept.items()]
    early += targets("R", dependent, layout.first_dependent)
    functions = [store_function("k", early, leaves, {})]
    factors = frozenset(parameters) if candidates else frozenset()
    one_by_one = [("jp", k, column) for k, column in enumerate(columns) if column] if candidates else []
    functions += [store_function(f"{name}{k}", column, leaves, kept) for name, k, column in one_by_one]
    functions += [
        store_function(name, found, leaves, kept, factors)
        for name, found in groups.items()
        if not (candidates and name == "jp")
    ]
    if candidates:
        functions.append(
            columns_function("jp", {memory.place("WANTED", k): f"eval_{name}{k}" for name, k, _ in one_by_one})
        )
    functions.append(reinit_function(model, reinits, {**leaves, **kept}, states))
    if model.initial is not None:
        rows_there = prepare(model.initial.residuals)
        there = {**leaves, **{u: f"m->data[{memory.at['START'] + i}]" for i, u in enumerate(model.initial.unknowns)}}
        found_there = _loop_targets(b, [model.initial], [rows_there], stage)[0]
        functions.append(loop_function("initial", found_there, there))
    functions.append(assertion_function(assertions, {**leaves, **kept}))
    functions += [loop_function(i, found, {**leaves, **kept}) for i, found in enumerate(loop_rows)]
    before = _step_starts(model, steps, prepare)
    functions.append(
        start_function(
            [(memory.place("R", i), memory.place("STARTED", i), n) for i, n in enumerate(starts) if n.op != "const"],
            [(memory.place("PRE", i), memory.place("D", i), n) for i, n in enumerate(before)],
            frozenset(states),
            b,
            leaves,
        )
    )
    given = [(memory.at["R"] + i, n.value) for i, n in enumerate(starts) if n.op == "const"]
    known = {**{s: n.value for s, n in hidden.items()}, **defaults}
    guesses = _guesses(model, unknowns, known)
    for group, at, numbers in (
        ("R", 2 * nx, [_attribute(v, "start", known, 0.0) for v in layout.inputs]),
        ("R", layout.first_parameter, list(defaults.values())),
        ("W", 0, guesses),
    ):
        given += [(memory.at[group] + at + i, x) for i, x in enumerate(numbers)]
    late = [t.node for g in (*groups.values(), *loop_rows) for t in g]
    counts = {
        "nx": nx, "nu": nu, "np": np_, "nq": nq, "ny": ny, "nw": nw, "nd": len(steps),
        "conditions": sum(s.name.startswith("when#") for s in steps), "relations": len(events.relations),
        "roundings": len(events.roundings), "samples": len(events.samplings), "blocks": len(loops),
        "surfaces": len(surfaces),
        "assertions": len(assertions), "time_varying": int(any(model.system.time in b.symbols(n) for n in late)),
        "size": max(memory.size, 1),
    }  # fmt: skip
    nominals = [_attribute(v, "nominal", known, 1.0) for v in layout.states]
    tables = {
        "double nominal": [repr(x) for x in nominals],
        "unsigned char below": [str(int(r.below)) for r in events.relations],
        "unsigned char timed": [str(int(i in instants)) for i in range(len(events.relations))],
        **_surface_tables(switching, steps),
        "Block block": _blocks(b, model.loops),
        "int initial_at": [
            leaves[u].removeprefix("m->data[").removesuffix("]")
            for u in (model.initial.unknowns if model.initial is not None else ())
        ],
        "char *const message": [c_string(message) for _, message in events.assertions],
    }
    in_lanes = None
    between_events = events.relations or events.roundings or events.samplings or steps or assertions
    known_there = {model.system.time, *states, *inputs, *parameters}
    plain = all(b.symbols(n) <= known_there for n in (*rates, *outputs))
    if not candidates and plain and states and not (loops or between_events):
        constants = {**{p: leaves[p] for p in parameters}, **kept}
        slopes = _jacobian(b, rates, states, stage, 0, by_rows=True)
        equations = LaneEquations(states, inputs, model.system.time, constants, rates, outputs, slopes)
        in_lanes = lane_functions(
            equations,
            {
                "first_input": 2 * nx,
                "first_output": layout.first_output,
                "time_varying": counts["time_varying"],
            },
        )
    if in_lanes is not None:
        functions.append(in_lanes[0])
        counts["lane_constants"] = len(in_lanes[1])
        tables["int lane_constant_at"] = [str(place) for place in in_lanes[1]]
    names = ("set_defaults", "start", *(f"{n}" for n in ("k", *groups)), "reinit", "violated")
    lines = [
        '#include "model.h"',
        "static const struct { int at; double value; } given[] = {",
        *(f"    {{{k}, {x!r}}}," for k, x in given),
        "};",
        "static void set_defaults(Model *m) {",
        f"    for (int k = 0; k < {len(given)}; k++) m->data[given[k].at] = given[k].value;",
        "}",
        *functions,
        *(f"static const {t}[] = {{{', '.join(items) or '0'}}};" for t, items in tables.items() if items),
        "const Info model_info = {",
        f'    .guid = "{guid}",',
        *(f"    .{name} = {count}," for name, count in counts.items()),
        *([f"    .initial = {{0, {sizes['START']}, eval_loop_initial}},"] if sizes["START"] else []),
        *(f"    .at[{name}] = {at}," for name, at in memory.at.items()),
        *(f"    .{t.rpartition(' ')[2]} = {t.rpartition(' ')[2]}," for t, items in tables.items() if items),
        *(f"    .{name} = {name if name in ('set_defaults', 'start') else f'eval_{name}'}," for name in names),
        "};",
    ]
    return "\n".join(lines) + "\n"


def _surface_sizes(surfaces: int, rows: int, nx: int, nu: int, np_: int) -> dict[str, int]:
    """Sizes of the groups that sliding needs (native/sliding.h)."""
    return {
        "RISE": surfaces, "RISE_RATE": surfaces * nx, "RISE_X": surfaces * (nx + nu), "RISE_P": surfaces * np_,
        "SIDES": (surfaces + 1) * rows if surfaces else 0, "ACROSS": surfaces * surfaces, "SHARE": surfaces,
        "CONTACT": surfaces, "NEAR": surfaces,
    }  # fmt: skip


def _surface_tables(switching: SwitchingModel, steps: Sequence[Node]) -> dict[str, list[str]]:
    """On which surface each relation changes, its truth above it, and which discrete variables have no memory."""
    if not switching.surfaces:
        return {"int surface": [], "unsigned char above": [], "unsigned char instant": []}
    place = {i: (k, above) for k, s in enumerate(switching.surfaces) for i, above in s.relations}
    relations = range(len(switching.model.discrete.relations))
    return {
        "int surface": [str(place[i][0] if i in place else -1) for i in relations],
        "unsigned char above": [str(int(i in place and place[i][1])) for i in relations],
        "unsigned char instant": [str(int(s in switching.instant)) for s in steps],
    }


def _blocks(b: Builder, loops: Sequence[AlgebraicLoop]) -> list[str]:
    found, at = [], 0
    for i, loop in enumerate(loops):
        slopes = (b.derivative(r, u) for r in loop.residuals for u in loop.unknowns)
        linear = not any(b.symbols(s) & set(loop.unknowns) for s in slopes)
        found.append(f"{{{at}, {len(loop.unknowns)}, eval_loop_{i}, {int(linear)}}}")
        at += len(loop.unknowns)
    return found


def _guesses(model: ExplicitModel, unknowns: Sequence[Node], values: dict[Node, float]) -> list[float]:
    """Where Newton's method starts: the start attributes."""
    by_name = {v.name: v for v in model.system.variables}
    return [_attribute(by_name[u.name], "start", values, 0.0) if u.name in by_name else 0.0 for u in unknowns]


def _step_starts(
    model: ExplicitModel, steps: Sequence[Node], prepare: Callable[[Iterable[Node]], list[Node]]
) -> list[Node]:
    """Values of the discrete variables before the first event."""
    b = model.system.builder
    by_name = {v.name: v for v in model.system.discrete_variables}
    given = model.discrete.before
    return prepare(
        given[s] if s in given else by_name[s.name].attributes.get("start", b.zero) if s.name in by_name else b.zero
        for s in steps
    )


def _loop_targets(
    b: Builder, loops: Sequence[AlgebraicLoop], residuals: Sequence[Sequence[Node]], stage: ParameterStage
) -> list[list[StoredValue]]:
    found = []
    for loop, rows in zip(loops, residuals, strict=True):
        slopes = _jacobian(b, rows, loop.unknowns, stage, 0)
        here = [StoredValue(f"f[{i}]", r) for i, r in enumerate(rows)]
        found.append(here + [StoredValue(t.place.replace("m->data", "j"), t.node) for t in slopes])
    return found


def _attribute(v: ScalarVariable, key: str, values: dict[Node, float], otherwise: float) -> float:
    node = v.attributes.get(key)
    return otherwise if node is None else evaluate_nodes([node], values)[0]


def _jacobian(
    b: Builder, rows: Sequence[Node], columns: Sequence[Node], stage: ParameterStage, at: int, *, by_rows: bool = False
) -> list[StoredValue]:
    targets = []
    rows_with: dict[Node, list[int]] = {}
    for i, row in enumerate(rows):
        for symbol in b.symbols(row):
            rows_with.setdefault(symbol, []).append(i)
    for j, symbol in enumerate(columns):
        memo: dict[Node, Node] = {}
        for i in rows_with.get(symbol, ()):
            slope = stage.reciprocal(b.derivative(rows[i], symbol, memo))
            if slope is not b.zero:
                place = str(i * len(columns) + j) if by_rows else f"m->data[{at + j * len(rows) + i}]"
                targets.append(StoredValue(place, slope))
    return targets
