"""Reads rumoca's structured flat model (``Model.to_json("flat")``) into :class:`~aero_bayes.modelica.flat.FlatModel`.

Every kind of node that occurs is either read or named in an :class:`InputError`; nothing is skipped.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

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
from aero_bayes.modelica.rumoca_trees import Json, TreeReader, message_of
from aero_bayes.modelica.syntax import (
    Array,
    AssertStatement,
    Assign,
    Expression,
    Name,
    Number,
    ReinitStatement,
    Statement,
    UnsupportedStatement,
    WhenStatement,
)

_VARIABILITY: dict[str, Variability] = {"Parameter": "parameter", "Constant": "constant", "Discrete": "discrete"}
_CAUSALITY: dict[str, Causality] = {"Input": "input", "Output": "output"}


def read_structured(name: str, flat: Json, files: Mapping[str, Sequence[str]]) -> FlatModel:
    """Return the flat model of rumoca's document."""
    return _FlatModelReader(name, flat, files).model()


class _FlatModelReader(TreeReader):
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
                bindings.append(FlatEquation(Name(v.name), v.binding, "binding", v.name.rpartition(".")[0], v.place))
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
            marks = [self.fixed(x) for x in fixed]
            attributes["fixed"] = marks[0] if len(marks) == 1 else Array(tuple(marks))
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

    def fixed(self, value: Any) -> Expression:
        return Number(float(value)) if isinstance(value, bool) else self.expression(value)

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
            origin, component = (
                "flow",
                _common(*re.findall(r"[^\s+=-][^\s+=]*", detail["description"].rpartition("=")[0])),
            )
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
        return FlatEquation(self.expression(residual), Number(0.0), origin, component, self.here)

    def when(self, chain: Json) -> When:
        first = chain["first"]
        self.here = self.place(first.get("span") or chain.get("span"))
        place = self.here
        branches = []
        for branch in (first, *chain.get("else_when", ())):
            body = tuple(map(self.action, branch["equations"]))
            branches.append((self.expression(branch["condition"]), body))
        return When(WhenStatement(tuple(branches)), place)

    def action(self, e: Json) -> Statement:
        kind, detail = next(iter(e.items()))
        self.here = self.place(detail.get("span")) or self.here
        match kind:
            case "Assign":
                return Assign((self.target(detail["target"]),), self.expression(detail["value"]))
            case "Reinit":
                return ReinitStatement(self.target(detail["state"]), self.expression(detail["value"]))
            case "Assert":
                return AssertStatement(self.expression(detail["condition"]), "")
            case "Terminate":
                return UnsupportedStatement("terminate()")
        raise self.fail(f"a {kind!r} in a when equation")

    def assertion(self, a: Json) -> Assertion:
        self.here = self.place(a["span"])
        return Assertion(self.expression(a["condition"]), message_of(a["message"]), self.here)

    def algorithm(self, a: Json) -> Algorithm:
        self.here = self.place(a.get("span"))
        outputs = [o.name if isinstance(o, Name) else "" for o in map(self.target, a["outputs"])]
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
