"""Reads the expressions and statements of rumoca's structured documents."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from typing import Any

from aero_bayes.errors import InputError
from aero_bayes.modelica import syntax
from aero_bayes.modelica.tokens import SourceLocation

Json = dict[str, Any]

_BINARY = {
    "Add": "+", "Sub": "-", "Mul": "*", "Div": "/", "Exp": "^", "AddElem": ".+", "SubElem": ".-", "MulElem": ".*",
    "DivElem": "./", "ExpElem": ".^", "Lt": "<", "Le": "<=", "Gt": ">", "Ge": ">=", "Eq": "==", "Neq": "<>",
    "And": "and", "Or": "or",
}  # fmt: skip
_UNARY = {"Minus": "neg", "DotMinus": "neg", "Not": "not"}


class TreeReader:
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


def message_of(tree: Json) -> str:
    """Return the literal parts of a message; what is computed in it is left out."""
    if "Literal" in tree:
        return str(tree["Literal"]["value"].get("String", ""))
    if "Binary" in tree:
        return f"{message_of(tree['Binary']['lhs'])}...{message_of(tree['Binary']['rhs'])}".replace("......", "...")
    return ""


def _ident(ident: Any) -> str:
    return str(ident["text"]) if isinstance(ident, dict) else str(ident)
