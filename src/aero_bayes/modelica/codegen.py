"""Explicit model -> C: one structure, lazily evaluated functions, exact Jacobians.

Expressions of parameters alone are computed when a parameter changes and kept (``m->k``); the rest is straight-line
code over local variables. The FMI functions around it are in ``native/fmi2.c``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from aero_bayes.modelica.causalisation import ExplicitModel
from aero_bayes.modelica.expression import Builder, Node, topological_order
from aero_bayes.modelica.linear_equations import AlgebraicLoop
from aero_bayes.modelica.prepared_model import (
    ParameterStage,
    PreparedModel,
    StoredValue,
    assertion_function,
    c_string,
    loop_function,
    reinit_function,
    start_function,
    store_function,
)
from aero_bayes.modelica.switching_surfaces import SwitchingModel, VariableLayout

#: Operations in linear equations; steps such as ``sign`` have a derivative without symbols too.
#: Inputs of a law that steps by the sign of a speed: whether its step is held, and at which value.
HELD, GIVEN = "direction_held", "direction_given"
_LINEAR = ("symbol", "add", "sub", "mul", "div", "neg")
#: Begins a function that the engine looks for in the library.
_MARK = '__attribute__((visibility("default"))) int'


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

    def targets(self, group: str, nodes: Iterable[Node], first: int = 0) -> list[StoredValue]:
        """Store expressions in a group, from its place ``first`` on."""
        return [StoredValue(self.place(group, first + i), n) for i, n in enumerate(nodes)]


@dataclass(frozen=True)
class _Code:
    """Values that the functions compute: by function of model.h, of each algebraic loop, and at events."""

    groups: dict[str, list[StoredValue]]
    loops: list[list[StoredValue]]
    reinits: list[Node]
    assertions: list[Node]

    @property
    def late(self) -> list[Node]:
        """Every expression that is computed at a time step."""
        return [t.node for g in (*self.groups.values(), *self.loops) for t in g]


def generate(switching: SwitchingModel, layout: VariableLayout, guid: str) -> str:
    """Write the complete C source of one model; native/fmi2.c is linked to it."""
    m = PreparedModel(switching, layout)
    memory, sizes = _memory_of(m)
    leaves = _leaves(m, memory)
    code = _code_of(m, memory)
    saved = m.stage.to_store(code.late + code.reinits + code.assertions)
    kept = {n: memory.place("K", i) for i, n in enumerate(saved)}
    memory.size += len(kept)
    functions = _functions(m, memory, code, leaves, kept)
    given = _given_values(m, memory)
    counts, tables = _counts(m, memory, code), _tables(m, leaves)
    events = m.model.discrete
    if not (events.relations or events.roundings or events.samplings or m.steps or events.assertions):
        functions.append(f"{_MARK} ab_eventless(void) {{ return 1; }}")
        if _is_linear(m):
            functions.append(f"{_MARK} ab_linear(void) {{ return 1; }}")
        elif _is_linear(m, held=True):
            functions.append(f"{_MARK} ab_linear_held(void) {{ return 1; }}")
    names = ("set_defaults", "start", "k", *code.groups, "reinit", "violated")
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


def _is_linear(m: PreparedModel, *, held: bool = False) -> bool:
    """Return whether rates and outputs are linear in states and inputs, with parameters as coefficients.

    ``held``: while the step of a law is, of a model that has such an input."""
    b, rows = m.builder, [*m.rates, *m.outputs]
    moving, known = frozenset([*m.states, *m.inputs]), frozenset(m.parameters)
    if held:
        values = {b.symbol(HELD): b.const(1.0)}
        if not moving & values.keys():
            return False
        rows = [b.substitute(row, values) for row in rows]
    slopes = (b.derivative(row, s) for row in rows for s in moving & b.symbols(row))
    return (
        all(b.symbols(row) <= known | moving for row in rows)
        and all(n.op in _LINEAR or not b.symbols(n) & moving for n in topological_order(rows, {}))
        and all(b.symbols(n) <= known for n in slopes)
    )


def _memory_of(m: PreparedModel) -> tuple[_Memory, dict[str, int]]:
    """Lay out all values of a model; the group ``K`` of kept expressions is last, and still empty."""
    events, nx, nu, np_ = m.model.discrete, len(m.states), len(m.inputs), len(m.parameters)
    nw, nrow = len(m.unknowns), len(m.rows)
    memory = _Memory()
    memory.add("R", m.layout.first_output + len(m.layout.outputs))
    memory.add("K", 0)  # the size is known once all expressions are
    sizes = {
        "W": nw, "D": len(m.steps), "PRE": len(m.steps), "REL": len(events.relations), "ROUND": len(events.roundings),
        "SAMPLE": len(events.samplings), "LAST": len(events.samplings), "INITIAL": 1, "STARTED": nx,
        "JX": nrow * (nx + nu), "JP": nrow * np_,
        "JW": nrow * nw, "FW": nw * nw, "FX": nw * (nx + nu), "FP": nw * np_,
        "DIFF": len(events.relations) + len(events.roundings), "TICK": 2 * len(events.samplings),
        "DUE": len(events.relations), "SLOPE": len(events.relations),
        "START": len(m.model.initial.unknowns) if m.model.initial is not None else 0,
        **_surface_sizes(len(m.switching.surfaces), nrow, nx, nu, np_),
    }  # fmt: skip
    for name, size in sizes.items():
        memory.add(name, size)
    memory.at["K"] = memory.size
    return memory, sizes


def _leaves(m: PreparedModel, memory: _Memory) -> dict[Node, str]:
    """Return where the value of each symbol stands."""
    b, events, nx = m.builder, m.model.discrete, len(m.states)
    leaves = {m.model.system.time: "m->time"}
    values = [
        ("R", 0, m.states), ("R", 2 * nx, m.inputs), ("R", m.layout.first_parameter, m.parameters),
        ("W", 0, m.unknowns), ("D", 0, m.steps), ("PRE", 0, [b.symbol(f"pre({s.name})") for s in m.steps]),
        ("REL", 0, [r.symbol for r in events.relations]), ("ROUND", 0, [r.symbol for r in events.roundings]),
        ("SAMPLE", 0, [s.symbol for s in events.samplings]), ("INITIAL", 0, [b.symbol("initial()")]),
    ]  # fmt: skip
    for group, first, symbols in values:
        leaves |= {s: memory.place(group, first + i) for i, s in enumerate(symbols)}
    return leaves | {s: memory.place("R", nx + i) for i, s in enumerate(m.switching.rates)}


def _code_of(m: PreparedModel, memory: _Memory) -> _Code:
    """Return what each function of model.h computes."""
    events, moving, targets = m.model.discrete, [*m.states, *m.inputs], memory.targets

    def jacobian(group: str, of: Sequence[Node], by: Sequence[Node]) -> list[StoredValue]:
        return _jacobian(m.builder, of, by, m.stage, memory.at[group])

    rises = m.prepare(s.rise for s in m.switching.surfaces)
    differences = m.prepare(r.difference for r in events.relations)
    instants = m.instants
    flat_loops = [r for loop in m.loops for r in loop]
    groups = {
        "dx": targets("R", m.rates, len(m.states)),
        "y": targets("R", m.outputs, m.layout.first_output),
        "jx": jacobian("JX", m.rows, moving),
        "jp": jacobian("JP", m.rows, m.parameters),
        "jw": [
            *jacobian("JW", m.rows, m.unknowns),
            *jacobian("FW", flat_loops, m.unknowns),
            *jacobian("FX", flat_loops, moving),
        ],
        "fp": jacobian("FP", flat_loops, m.parameters),
        "discrete": targets("D", m.prepare(events.updates[s] for s in m.steps)),
        "watch": targets("DIFF", [*differences, *m.prepare(r.argument for r in events.roundings)]),
        "times": [
            *targets("TICK", m.prepare(x for s in events.samplings for x in (s.start, s.interval))),
            *(StoredValue(memory.place("DUE", i), m.prepare([t[0]])[0]) for i, t in instants.items()),
            *(StoredValue(memory.place("SLOPE", i), m.prepare([t[1]])[0]) for i, t in instants.items()),
        ],
        "rise": targets("RISE", rises),
        "rise_slopes": [
            *jacobian("RISE_RATE", rises, m.switching.rates),
            *jacobian("RISE_X", rises, moving),
            *jacobian("RISE_P", rises, m.parameters),
        ],
    }
    reinits = m.prepare(x for r in events.reinits for x in (r.active, r.value))
    assertions = m.prepare(c for c, _ in events.assertions)
    return _Code(groups, _loop_targets(m.builder, m.model.loops, m.loops, m.stage), reinits, assertions)


def _functions(
    m: PreparedModel,
    memory: _Memory,
    code: _Code,
    leaves: dict[Node, str],
    kept: dict[Node, str],
) -> list[str]:
    """Write the C functions of the model's equations."""
    model, b = m.model, m.builder
    early = [StoredValue(place, n) for n, place in kept.items()]
    early += memory.targets("R", m.dependent, m.layout.first_dependent)
    everything = {**leaves, **kept}
    functions = [store_function("k", early, leaves, {})]
    functions += [store_function(name, values, leaves, kept) for name, values in code.groups.items()]
    functions.append(reinit_function(model, code.reinits, everything, m.states))
    if model.initial is not None:
        rows = m.prepare(model.initial.residuals)
        there = {**leaves, **{u: f"m->data[{memory.at['START'] + i}]" for i, u in enumerate(model.initial.unknowns)}}
        functions.append(loop_function("initial", _loop_targets(b, [model.initial], [rows], m.stage)[0], there))
    functions.append(assertion_function(code.assertions, everything))
    functions += [loop_function(i, values, everything) for i, values in enumerate(code.loops)]
    before = m.prepare(m.step_starts())
    functions.append(
        start_function(
            [(memory.place("R", i), memory.place("STARTED", i), n) for i, n in enumerate(m.starts) if n.op != "const"],
            [(memory.place("PRE", i), memory.place("D", i), n) for i, n in enumerate(before)],
            frozenset(m.states),
            b,
            leaves,
        )
    )
    return functions


def _given_values(m: PreparedModel, memory: _Memory) -> list[tuple[int, float]]:
    """Places and numbers that a model begins with."""
    given = [(memory.at["R"] + i, n.value) for i, n in enumerate(m.starts) if n.op == "const"]
    for group, at, numbers in (
        ("R", 2 * len(m.states), [v.attribute("start", m.constants, 0.0) for v in m.layout.inputs]),
        ("R", m.layout.first_parameter, list(m.defaults.values())),
        ("W", 0, _guesses(m.model, m.unknowns, m.constants)),
    ):
        given += [(memory.at[group] + at + i, x) for i, x in enumerate(numbers)]
    return given


def _counts(m: PreparedModel, memory: _Memory, code: _Code) -> dict[str, int]:
    """Numbers of ``Info`` of model.h."""
    b, events, layout = m.builder, m.model.discrete, m.layout
    return {
        "nx": len(m.states), "nu": len(m.inputs), "np": len(m.parameters), "nq": len(layout.dependent),
        "ny": len(layout.outputs), "nw": len(m.unknowns), "nd": len(m.steps),
        "conditions": sum(s.name.startswith("when#") for s in m.steps), "relations": len(events.relations),
        "roundings": len(events.roundings), "samples": len(events.samplings), "blocks": len(m.loops),
        "surfaces": len(m.switching.surfaces), "assertions": len(code.assertions),
        "time_varying": int(any(m.model.system.time in b.symbols(n) for n in code.late)), "size": max(memory.size, 1),
    }  # fmt: skip


def _tables(m: PreparedModel, leaves: dict[Node, str]) -> dict[str, list[str]]:
    """Arrays of ``Info`` of model.h, by their declaration."""
    events, initial = m.model.discrete, m.model.initial
    return {
        "double nominal": [repr(v.attribute("nominal", m.constants, 1.0)) for v in m.layout.states],
        "unsigned char below": [str(int(r.below)) for r in events.relations],
        "unsigned char timed": [str(int(i in m.instants)) for i in range(len(events.relations))],
        **_surface_tables(m.switching, m.steps),
        "Block block": _blocks(m.builder, m.model.loops),
        "int initial_at": [
            leaves[u].removeprefix("m->data[").removesuffix("]")
            for u in (initial.unknowns if initial is not None else ())
        ],
        "char *const message": [c_string(message) for _, message in events.assertions],
    }


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
    """Return where Newton's method starts: the start attributes."""
    by_name = {v.name: v for v in model.system.variables}
    return [by_name[u.name].attribute("start", values, 0.0) if u.name in by_name else 0.0 for u in unknowns]


def _loop_targets(
    b: Builder, loops: Sequence[AlgebraicLoop], residuals: Sequence[Sequence[Node]], stage: ParameterStage
) -> list[list[StoredValue]]:
    found = []
    for loop, rows in zip(loops, residuals, strict=True):
        slopes = _jacobian(b, rows, loop.unknowns, stage, 0)
        here = [StoredValue(f"f[{i}]", r) for i, r in enumerate(rows)]
        found.append(here + [StoredValue(t.place.replace("m->data", "j"), t.node) for t in slopes])
    return found


def _jacobian(
    b: Builder, rows: Sequence[Node], columns: Sequence[Node], stage: ParameterStage, at: int
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
                place = f"m->data[{at + j * len(rows) + i}]"
                targets.append(StoredValue(place, slope))
    return targets
