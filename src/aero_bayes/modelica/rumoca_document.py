"""Reads rumoca's flat model (``Model.to_json("flat")``) into :class:`~aero_bayes.modelica.flat.FlatModel`."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

from aero_bayes.errors import InputError
from aero_bayes.modelica import syntax
from aero_bayes.modelica.flat import (
    Algorithm,
    Argument,
    Assertion,
    Causality,
    FlatEquation,
    FlatModel,
    FlatVariable,
    Function,
    Origin,
    Variability,
    When,
)
from aero_bayes.modelica.parse import SourceLocation

Json = dict[str, Any]

_BINARY = {
    "Add": "+", "Sub": "-", "Mul": "*", "Div": "/", "Exp": "^", "AddElem": ".+", "SubElem": ".-", "MulElem": ".*",
    "DivElem": "./", "ExpElem": ".^", "Lt": "<", "Le": "<=", "Gt": ">", "Ge": ">=", "Eq": "==", "Neq": "<>",
    "And": "and", "Or": "or",
}  # fmt: skip
_UNARY = {"Minus": "neg", "DotMinus": "neg", "Not": "not"}
_VARIABILITY: dict[str, Variability] = {"Parameter": "parameter", "Constant": "constant", "Discrete": "discrete"}
_CAUSALITY: dict[str, Causality] = {"Input": "input", "Output": "output"}


def read_structured(name: str, flat: Json, files: Mapping[str, Sequence[str]]) -> FlatModel:
    """Return the flat model of rumoca's document."""
    return _FlatModelReader(name, flat, files).model()


class _FlatModelReader:
    """Turns nodes into trees; ``here`` is the place that messages name.

    Every kind of node that occurs is either read or named in an :class:`InputError`; nothing is skipped."""

    def __init__(self, name: str, flat: Json, files: Mapping[str, Sequence[str]]) -> None:
        self.name = name
        self.flat = flat
        self.files = files
        self.lines: dict[str, list[int]] = {}
        self.enumerations: Mapping[str, int] = flat["enum_literal_ordinals"]
        self.binders: dict[str, int] = {}
        self.here: SourceLocation | None = None

    # places and failures

    def place(self, span: Json | None) -> SourceLocation | None:
        """Return the place in a file that a span of the document means; None where its file is not known."""
        key = str(span["source"]) if span else ""
        if span is None or key not in self.files:
            return None
        path, text = self.files[key]
        if key not in self.lines:
            self.lines[key] = [m.start() for m in re.finditer(b"\n", text.encode())]
        start, end = int(span["start"]), int(span["end"])
        return SourceLocation(path, start, end, bisect_right(self.lines[key], start - 1) + 1)

    def fail(self, what: str) -> InputError:
        """Return the error for a construct that cannot be translated, at the current place."""
        return InputError(f"{self.here or self.name}: the embedded exporter cannot translate {what}")

    def target(self, t: Any) -> syntax.Name:
        """Return the variable that an assignment or a reinit sets."""
        if isinstance(t, str):
            return syntax.Name(t)
        if "name" in t:
            return syntax.Name(str(t["name"]))
        tree = self.expression(t) if "VarRef" in t else self.reference(t)
        if not isinstance(tree, syntax.Name):
            raise self.fail("the target of an assignment")
        return tree

    # statements

    def statements(self, body: Sequence[Json]) -> tuple[syntax.Statement, ...]:
        """Return the statements of an algorithm or of a branch."""
        return tuple(s for item in body for s in self.statement(item))

    def statement(self, s: Json | str) -> tuple[syntax.Statement, ...]:
        """Return one statement; none for an empty one, several nested ones for a loop over several indices."""
        if isinstance(s, str):
            if s == "Empty":
                return ()
            return (syntax.UnsupportedStatement(f"the statement {s.lower()!r}"),)
        kind, d = next(iter(s.items()))
        match kind:
            case "Empty":
                return ()
            case "Assignment":
                return (syntax.Assign((self.reference(d["comp"]),), self.expression(d["value"])),)
            case "FunctionCall":
                call = syntax.Call(self.function_name(d["comp"]), tuple(map(self.expression, d["args"])))
                targets = tuple(self.optional(o) for o in d["outputs"])
                return (syntax.Assign(targets, call),)
            case "If":
                branches = tuple((self.expression(b["cond"]), self.statements(b["stmts"])) for b in d["cond_blocks"])
                return (syntax.IfStatement(branches, self.statements(d.get("else_block") or ())),)
            case "For":
                inner = self.statements(d["equations"])
                for index in reversed(d["indices"]):
                    inner = (syntax.ForStatement(_ident(index["ident"]), self.expression(index["range"]), inner),)
                return inner
            case "While":
                block = d["block"]
                return (syntax.WhileStatement(self.expression(block["cond"]), self.statements(block["stmts"])),)
            case "When":
                blocks = tuple((self.expression(b["cond"]), self.statements(b["stmts"])) for b in d["blocks"])
                return (syntax.WhenStatement(blocks),)
            case "Reinit":
                return (
                    syntax.ReinitStatement(self.target(d.get("variable") or d["state"]), self.expression(d["value"])),
                )
            case "Assert":
                return (syntax.AssertStatement(self.expression(d["condition"]), message_of(d["message"])),)
        return (syntax.UnsupportedStatement(f"the statement {kind.lower()!r}"),)

    def optional(self, o: Any) -> syntax.Name | None:
        """Return the target of one result of a function; None where it is left out."""
        if o is None or o == "Empty" or (isinstance(o, dict) and "Empty" in o):
            return None
        return self.target(o)

    def function_name(self, comp: Json) -> str:
        """Full name of the function that a statement calls."""
        return str(comp["name"]) if "name" in comp else ".".join(_ident(p["ident"]) for p in comp["parts"])

    def reference(self, comp: Json) -> syntax.Name:
        """Return a component reference, its constant subscripts as part of the name."""
        parts = comp["parts"]
        words = []
        for p in parts[:-1]:
            inner = [self.subscript(x) for x in p.get("subs") or ()]
            if any(not isinstance(x, syntax.Number) for x in inner):
                raise self.fail("a component that a loop variable selects in an algorithm")
            words.append(
                _ident(p["ident"])
                + (f"[{','.join(f'{x.value:g}' for x in inner if isinstance(x, syntax.Number))}]" if inner else "")
            )
        words.append(_ident(parts[-1]["ident"]))
        return syntax.Name(".".join(words), tuple(self.subscript(x) for x in parts[-1].get("subs") or ()))

    # expressions

    def subscript(self, s: Json) -> syntax.Expression:
        """Return one subscript: a number, an expression, or the colon."""
        kind, d = next(iter(s.items()))
        match kind:
            case "Index":
                return syntax.Number(float(d["value"]))
            case "Expr":
                return self.expression(d["expr"])
            case "Colon":
                return syntax.WholeDimension()
        raise self.fail(f"a subscript of the kind {kind!r}")

    def expression(self, e: Json) -> syntax.Expression:
        """Return the syntax tree of an expression."""
        kind, d = next(iter(e.items()))
        match kind:
            case "Literal":
                return self.literal(d["value"])
            case "VarRef":
                return self.variable_reference(d)
            case "Binary":
                if d["op"] not in _BINARY:
                    raise self.fail(f"the operator {d['op']!r}")
                return syntax.Call(_BINARY[d["op"]], (self.expression(d["lhs"]), self.expression(d["rhs"])))
            case "Unary":
                inner = self.expression(d["rhs"])
                if d["op"] in ("Plus", "DotPlus"):
                    return inner
                return syntax.Call(_UNARY[d["op"]], (inner,))
            case "BuiltinCall":
                name = d["function"][0].lower() + d["function"][1:]
                return syntax.Call(name, tuple(map(self.expression, d["args"])))
            case "FunctionCall":
                self.here = self.place(d.get("span")) or self.here
                return syntax.Call(str(d["name"]["name"]), tuple(map(self.expression, d["args"])))
            case "If":
                tree = self.expression(d["else_branch"])
                for condition, value in reversed(d["branches"]):
                    tree = syntax.If(self.expression(condition), self.expression(value), tree)
                return tree
            case "Array":
                items = tuple(map(self.expression, d["elements"]))
                joined = {"Horizontal": "[,]", "Vertical": "[;]"}.get(d.get("kind"))
                return syntax.Array(items) if joined is None else syntax.Call(joined, items)
            case "Tuple":
                return syntax.Array(tuple(map(self.expression, d["elements"])))
            case "Range":
                step = self.expression(d["step"]) if d.get("step") is not None else None
                return syntax.RangeExpression(self.expression(d["start"]), step, self.expression(d["end"]))
            case "ArrayComprehension":
                return self.comprehension(d)
            case "Index":
                return syntax.Index(self.expression(d["base"]), tuple(map(self.subscript, d["subscripts"])))
            case "FieldAccess":
                return syntax.Field(self.expression(d["base"]), str(d["field"]))
        raise self.fail(f"an expression of the kind {kind!r}")

    def comprehension(self, d: Json) -> syntax.Expression:
        """``{expression for i in range}``, the last index innermost."""
        if d.get("filter") is not None:
            raise self.fail("a filter in an array comprehension")
        tree = self.expression(d["expr"])
        for index in reversed(d["indices"]):
            tree = syntax.Comprehension(tree, str(index["name"]), self.expression(index["range"]))
        return tree

    def literal(self, value: Json) -> syntax.Expression:
        """Return a number, a Boolean as 0 or 1, or a text."""
        kind, v = next(iter(value.items()))
        match kind:
            case "Real" | "Integer" | "Boolean":
                return syntax.Number(float(v))
            case "String":
                return syntax.Text(str(v))
        raise self.fail(f"a literal of the kind {kind!r}")

    def variable_reference(self, d: Json) -> syntax.Expression:
        """Return a variable; an index of an unrolled loop or an enumeration literal becomes its number."""
        name = str(d["name"]["name"])
        subscripts = tuple(map(self.subscript, d["subscripts"]))
        if self.binders:
            if name in self.binders and not subscripts:
                return syntax.Number(float(self.binders[name]))
            for binder, value in self.binders.items():
                name = re.sub(rf"(?<=[\[,]){re.escape(binder)}(?=[\],])", str(value), name)
        if name in self.enumerations and name not in self.flat["variables"]:
            return syntax.Number(float(self.enumerations[name]))
        return syntax.Name(name, subscripts)

    # the model

    def model(self) -> FlatModel:
        f = self.flat
        if f["branches"]:
            raise self.fail("overconstrained connections")
        types: Mapping[str, str] = f["variable_type_names"]
        final = f.get("variable_final_flags") or {}
        variables = [self.variable(v, types.get(n, "Real"), bool(final.get(n))) for n, v in f["variables"].items()]
        bindings = []
        for i, v in enumerate(variables):
            if not v.constant and v.binding is not None:
                bindings.append(
                    FlatEquation(syntax.Name(v.name), v.binding, "binding", v.name.rpartition(".")[0], v.place)
                )
                variables[i] = replace(v, binding=None)
        types_of = {str(key): r for key, r in f["record_types"].items()}
        fields = {key: tuple(str(x["name"]) for x in r["fields"]) for key, r in types_of.items()}
        records = {str(r["name"]): fields[key] for key, r in types_of.items()}
        for name, r in f["record_instances"].items():
            if str(r["type_def_id"]) in fields:
                records[name] = fields[str(r["type_def_id"])]
        return FlatModel(
            self.name,
            tuple(variables),
            (*self.equations(f["equations"], f["structured_equations"]), *bindings),
            tuple(self.equations(f["initial_equations"], f["initial_structured_equations"])),
            tuple(map(self.algorithm, f["algorithms"])),
            tuple(map(self.algorithm, f["initial_algorithms"])),
            tuple(map(self.when, f["when_chains"])),
            tuple(self.assertion(a) for a in (*f["assert_equations"], *f["initial_assert_equations"])),
            {n: self.function(x) for n, x in f["functions"].items()},
            records,
            str(f.get("model_description") or ""),
            dict(self.enumerations),
        )

    def variable(self, v: Json, type_name: str, final: bool) -> FlatVariable:
        self.here = self.place(v["source_span"])
        attributes = {k: self.expression(v[k]) for k in ("start", "min", "max", "nominal") if v[k] is not None}
        fixed = v["fixed"]
        if fixed is not None:
            marks = [syntax.Number(float(x)) if isinstance(x, bool) else self.expression(x) for x in fixed]
            attributes["fixed"] = marks[0] if len(marks) == 1 else syntax.Array(tuple(marks))
        variability = _VARIABILITY.get(_word(v["variability"]), "discrete" if v["is_discrete_type"] else "continuous")
        return FlatVariable(
            name=v["name"],
            type=type_name,
            variability=variability,
            causality=_CAUSALITY.get(_word(v["causality"]), "local"),
            sizes=tuple(int(d) for d in v["dims"]),
            unit=v["unit"] or "",
            attributes=attributes,
            binding=None if v["binding"] is None else self.expression(v["binding"]),
            flow=bool(v["flow"]),
            state_select=str(v["state_select"]).lower(),
            protected=bool(v["is_protected"]),
            final=final,
            description=v["description"] or "",
            place=self.here,
        )

    def equations(self, plain: Sequence[Json], families: Sequence[Json]) -> Iterator[FlatEquation]:
        """Equations; families of a loop hold two of their equations and a template for the rest."""
        templates = {
            int(s.get("first_equation_index") or 0): s
            for s in families
            if s.get("template") is not None and not s.get("interiors_materialized")
        }
        at = 0
        while at < len(plain):
            family = templates.get(at)
            if family is None:
                yield self.equation(plain[at])
                at += 1
                continue
            binders = family["domain"]["binders"]
            ranges = [range(int(b["lower"]), int(b["upper"]) + 1, int(b["step"])) for b in binders]
            for point in product(*ranges):
                self.binders = dict(zip((str(b["display_name"]) for b in binders), point, strict=True))
                for body in family["template"]["body"]:
                    yield self.equation({**plain[at], "residual": body})
                    at += 1
            self.binders = {}

    def equation(self, e: Json) -> FlatEquation:
        self.here = self.place(e["span"])
        kind, detail = next(iter(e["origin"].items()))
        origin: Origin = "component"
        if kind == "Connection":
            origin, component = "connection", _common(detail["lhs"], detail["rhs"])
        elif kind == "FlowSum":
            summed = re.findall(r"[^\s+=-][^\s+=]*", detail["description"].rpartition("=")[0])
            origin, component = "flow", _common(*summed)
        elif kind == "UnconnectedFlow":
            origin, component = "flow", str(detail["variable"]).rpartition(".")[0]
        elif kind == "Binding":
            origin, component = "binding", str(detail.get("variable", "")).rpartition(".")[0]
        elif kind == "ComponentEquation":
            component = str(detail["component"])
        else:
            raise self.fail(f"an equation of the kind {kind!r}")
        residual = e["residual"]
        difference = residual.get("Binary") if isinstance(residual, dict) else None
        if difference is not None and difference["op"] == "Sub" and origin != "flow":
            return FlatEquation(
                self.expression(difference["lhs"]), self.expression(difference["rhs"]), origin, component, self.here
            )
        return FlatEquation(self.expression(residual), syntax.Number(0.0), origin, component, self.here)

    def when(self, chain: Json) -> When:
        first = chain["first"]
        self.here = self.place(first.get("span") or chain.get("span"))
        place = self.here
        branches = []
        for branch in (first, *chain.get("else_when", ())):
            body = tuple(map(self.action, branch["equations"]))
            branches.append((self.expression(branch["condition"]), body))
        return When(syntax.WhenStatement(tuple(branches)), place)

    def action(self, e: Json) -> syntax.Statement:
        kind, detail = next(iter(e.items()))
        self.here = self.place(detail.get("span")) or self.here
        match kind:
            case "Assign":
                return syntax.Assign((self.target(detail["target"]),), self.expression(detail["value"]))
            case "Reinit":
                return syntax.ReinitStatement(self.target(detail["state"]), self.expression(detail["value"]))
            case "Assert":
                return syntax.AssertStatement(self.expression(detail["condition"]), "")
            case "Terminate":
                return syntax.UnsupportedStatement("terminate()")
        raise self.fail(f"a {kind!r} in a when equation")

    def assertion(self, a: Json) -> Assertion:
        self.here = self.place(a["span"])
        return Assertion(self.expression(a["condition"]), message_of(a["message"]), self.here)

    def algorithm(self, a: Json) -> Algorithm:
        self.here = self.place(a.get("span"))
        outputs = [o.name if isinstance(o, syntax.Name) else "" for o in map(self.target, a["outputs"])]
        return Algorithm(self.statements(a["statements"]), tuple(dict.fromkeys(outputs)), self.here)

    def function(self, f: Json) -> Function:
        self.here = self.place(f.get("span"))

        def arguments(group: str) -> tuple[Argument, ...]:
            return tuple(
                Argument(
                    str(a["name"]),
                    tuple(self.subscript(s) for s in a.get("shape_expr") or ()),
                    self.expression(a["default"]) if a.get("default") is not None else None,
                    str(a["type_name"]),
                )
                for a in f.get(group) or ()
            )

        external = f.get("external")
        return Function(
            str(f["name"]),
            arguments("inputs"),
            arguments("outputs"),
            arguments("locals"),
            self.statements(f.get("body") or ()),
            bool(f.get("is_constructor")),
            str(external["function_name"] or f["name"]) if external else "",
        )


def message_of(tree: Json) -> str:
    """Return the literal parts of a message; what is computed in it is left out."""
    if "Literal" in tree:
        return str(tree["Literal"]["value"].get("String", ""))
    if "Binary" in tree:
        return f"{message_of(tree['Binary']['lhs'])}...{message_of(tree['Binary']['rhs'])}".replace("......", "...")
    return ""


def _ident(ident: Any) -> str:
    return str(ident["text"]) if isinstance(ident, dict) else str(ident)


def _word(tagged: Any) -> str:
    return str(next(iter(tagged))) if isinstance(tagged, dict) else str(tagged)


def _common(*names: str) -> str:
    """Return the instance that holds the connectors: the longest path that all names share, without the connector."""
    paths = [n.lstrip("-").split(".")[:-1] for n in names]
    shared = []
    for level in zip(*paths, strict=False):
        if len(set(level)) > 1:
            break
        shared.append(level[0])
    return ".".join(shared)
