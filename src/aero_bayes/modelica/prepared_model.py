"""A model prepared for its C source: stages of its parameters, and functions."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

from aero_bayes.modelica.causalisation import ExplicitModel
from aero_bayes.modelica.expression import Builder, ExpressionWriter, Node, evaluate_nodes, topological_order
from aero_bayes.modelica.switching_surfaces import SwitchingModel, VariableLayout

#: Values that a function stores at most, where it is long and can be cut.
_PART = 100


@dataclass(frozen=True)
class StoredValue:
    """Where a value goes in the structure."""

    place: str
    node: Node


def loop_function(k: int | str, targets: Sequence[StoredValue], leaves: dict[Node, str]) -> str:
    """Return the function of one algebraic loop: its residuals into ``f``, their Jacobian by columns into ``j``."""
    writer = ExpressionWriter(leaves, [t.node for t in targets])
    stores = [f"    {t.place} = {writer.term(t.node)};" for t in targets]
    head = f"static void eval_loop_{k}(const Model *restrict m, double *restrict f, double *restrict j) {{"
    return "\n".join([head, "    (void)m;", *writer.lines, *stores, "}"])


def assertion_function(conditions: Sequence[Node], leaves: dict[Node, str]) -> str:
    """Return the function that marks the assertions that do not hold, and tells whether there are any."""
    writer = ExpressionWriter(leaves, conditions)
    lines = [f"    any |= bad[{i}] = !({writer.term(c)});" for i, c in enumerate(conditions)]
    head = ["static int eval_violated(Model *m, unsigned char *bad) {", "    int any = 0; (void)m; (void)bad;"]
    return "\n".join([*head, *writer.lines, *lines, "    return any;", "}"])


def c_string(message: str) -> str:
    """Return a message as a C string literal of plain ASCII."""
    plain = message.encode("ascii", "replace").decode().replace("\\", "/").replace('"', "'").replace("\n", " ")
    return f'"{plain}"'


def reinit_function(
    model: ExplicitModel, prepared: Sequence[Node], leaves: dict[Node, str], states: Sequence[Node]
) -> str:
    """Return the function that gives states the values of active ``reinit()``, and tells whether there are any."""
    writer = ExpressionWriter(leaves, prepared)
    lines = [
        f"    if ({writer.term(active)}) {{ {leaves[r.state]} = {writer.term(value)}; any = 1; }}"
        for r, active, value in zip(model.discrete.reinits, prepared[::2], prepared[1::2], strict=True)
    ]
    head = ["static int eval_reinit(Model *m) {", "    int any = 0; (void)m;"]
    return "\n".join([*head, *writer.lines, *lines, "    return any;", "}"])


def store_function(name: str, targets: Sequence[StoredValue], leaves: dict[Node, str], kept: dict[Node, str]) -> str:
    """Return a function that stores values; in several where it is long and they share little.

    The time that a compiler takes for a function grows with the square of its length."""

    def body(part: Sequence[StoredValue]) -> list[str]:
        writer = ExpressionWriter({**leaves, **kept}, [t.node for t in part])
        return [*writer.lines, *(f"    {t.place} = {writer.term(t.node)};" for t in part)]

    whole, lines = body(targets) or ["    (void)m;"], []
    parts = [body(targets[k : k + _PART]) for k in range(0, len(targets), _PART)]
    if len(whole) > 20 * _PART and sum(map(len, parts)) < 1.5 * len(whole):
        for k, part in enumerate(parts):
            lines += [f"static __attribute__((noinline)) void eval_{name}_{k}(Model *restrict m) {{", *part, "}"]
        whole = [f"    eval_{name}_{k}(m);" for k in range(len(parts))]
    return "\n".join([*lines, f"static void eval_{name}(Model *restrict m) {{", *whole, "}"])


def start_function(
    starts: Sequence[tuple[str, str, Node]],
    steps: Sequence[tuple[str, str, Node]],
    states: frozenset[Node],
    b: Builder,
    leaves: dict[Node, str],
) -> str:
    """Initial values that depend on parameters, then those that depend on other states' initial values."""
    lines: list[str] = []
    for later in (False, True):
        group = [s for s in starts if bool(b.symbols(s[2]) & states) is later]
        writer = ExpressionWriter(leaves, [n for _, _, n in group])
        stores = [f"    if (!{set_}) {place} = {writer.term(n)};" for place, set_, n in group]
        lines += ["    {", *writer.lines, *stores, "    }"] if group else []
    writer = ExpressionWriter(leaves, [n for _, _, n in steps])
    lines += [*writer.lines, *(f"    {pre} = {now} = {writer.term(n)};" for pre, now, n in steps)]
    return "\n".join(["static void start(Model *m) {", *(lines or ["    (void)m;"]), "}"])


class ParameterStage:
    """Tells expressions of parameters alone from the rest, and turns division by one into multiplication."""

    def __init__(self, builder: Builder, parameters: frozenset[Node]) -> None:
        self.builder = builder
        self.parameters = parameters
        self._memo: dict[Node, Node] = {}

    def of_parameters_only(self, node: Node) -> bool:
        """Return whether an expression depends on parameters alone."""
        return self.builder.symbols(node) <= self.parameters

    def reciprocal(self, node: Node) -> Node:
        """Return the expression with divisions by early expressions as multiplications by their reciprocals."""
        b = self.builder
        for n in topological_order([node], self._memo):
            args = tuple(self._memo[a] for a in n.args)
            if n.op == "div" and self.of_parameters_only(args[1]) and not self.of_parameters_only(args[0]):
                self._memo[n] = b.mul(args[0], b.div(b.one, args[1]))
            else:
                self._memo[n] = b.apply(n, args) if n.args else n
        return self._memo[node]

    def to_store(self, nodes: Sequence[Node]) -> list[Node]:
        """Early expressions (no plain symbols or constants) that late ones or the results use directly."""
        found: dict[Node, None] = {}

        def consider(n: Node) -> None:
            if n.args and self.of_parameters_only(n):
                found.setdefault(n)

        for n in nodes:
            consider(n)
        for n in topological_order(nodes, {}, lambda n: not self.of_parameters_only(n)):
            if not self.of_parameters_only(n):
                for a in n.args:
                    consider(a)
        return sorted(found, key=lambda n: n.index)


class PreparedModel:
    """A model as its C source computes it: symbols, and expressions with as little work at a time step as possible.

    Parameters of inner components that nothing shows are replaced by their values, and divisions by parameters are
    multiplications."""

    def __init__(self, switching: SwitchingModel, layout: VariableLayout) -> None:
        self.switching, self.layout, self.model = switching, layout, switching.model
        model, b = self.model, self.model.system.builder
        self.builder = b
        self.states = [b.symbol(p) for p in layout.state_paths]
        self.inputs = [b.symbol(v.name) for v in layout.inputs]
        self.parameters = [b.symbol(v.name) for v in layout.parameters]
        self.unknowns = [u for loop in model.loops for u in loop.unknowns]
        self.steps = sorted(model.discrete.updates, key=lambda s: s.name.startswith("when#"))
        self.stage = ParameterStage(b, frozenset(self.parameters))
        self.defaults = {
            p: evaluate_nodes([v.binding], {})[0]
            for p, v in zip(self.parameters, layout.parameters, strict=True)
            if v.binding
        }
        hidden = {
            b.symbol(v.name): v.binding
            for v in model.system.parameters
            if v.binding is not None and v.binding.op == "const" and b.symbol(v.name) not in self.defaults
        }
        #: Values of all parameters.
        self.constants = {**{s: n.value for s, n in hidden.items()}, **self.defaults}
        self._memo = hidden
        self.rates = self.prepare(model.rates)
        self.outputs = self.prepare(model.solved[v.name] for v in layout.outputs)
        self.dependent = self.prepare(v.binding for v in layout.dependent if v.binding is not None)
        self.starts = self.prepare(model.starts)
        self.loops = [self.prepare(loop.residuals) for loop in model.loops]
        self.rows = [*self.rates, *self.outputs, *self.dependent]

    @cached_property
    def instants(self) -> dict[int, tuple[Node, Node]]:
        """Relations that change at a known time: by their number, that time and its slope."""
        relations = enumerate(self.model.discrete.relations)
        return {i: t for i, r in relations if (t := self.model.time_of_change(r.difference)) is not None}

    def prepare(self, nodes: Iterable[Node]) -> list[Node]:
        """Return expressions as they are computed."""
        return [self.stage.reciprocal(self.builder.substitute(n, self._memo)) for n in nodes]

    def step_starts(self) -> Iterator[Node]:
        """Yield values of the discrete variables before the first event."""
        by_name = {v.name: v for v in self.model.system.discrete_variables}
        given, zero = self.model.discrete.before, self.builder.zero
        for s in self.steps:
            declared = by_name[s.name].attributes.get("start", zero) if s.name in by_name else zero
            yield given.get(s, declared)
