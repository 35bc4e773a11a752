"""Reads the flat Modelica text that rumoca writes.

Declarations, equations, initial equations and functions occur there. Everything else is an :class:`InputError` that
names what was found; nothing is skipped.
"""

from __future__ import annotations

import re

from aero_bayes.errors import InputError
from aero_bayes.export.syntax import (
    Array,
    Assign,
    Call,
    Comprehension,
    Declaration,
    Equal,
    Equation,
    Expression,
    FlatModel,
    ForEquation,
    ForStatement,
    Function,
    If,
    IfStatement,
    Index,
    Name,
    Number,
    Range,
    Statement,
    Text,
)

_TOKEN = re.compile(
    r"""(?P<space>\s+|//[^\n]*|/\*.*?\*/)
      | (?P<number>\d+\.?\d*(?:[eE][+-]?\d+)?)
      | (?P<name>(?:[A-Za-z_]\w*|'(?:[^'\\]|\\.)*')(?:(?:\[[\d,\s]+\])?\.(?:[A-Za-z_]\w*|'(?:[^'\\]|\\.)*'))*)
      | (?P<text>"(?:[^"\\]|\\.)*")
      | (?P<sign>:=|<=|>=|<>|==|\.\*|\./|\.\+|\.-|\.\^|[-+*/^()\[\]{},;:=<>])""",
    re.VERBOSE | re.DOTALL,
)
_PREFIXES = frozenset({"parameter", "constant", "discrete", "input", "output", "flow", "stream", "final", "protected"})
_COMPARISONS = frozenset({"<", "<=", ">", ">=", "==", "<>"})
_CLASS_WORDS = frozenset({"class", "model", "package", "block", "record", "type", "connector", "operator"})
_ESCAPES = {"n": "\n", "t": "\t"}


class _Parser:
    def __init__(self, text: str) -> None:
        self.tokens: list[tuple[str, str]] = []
        at = 0
        while at < len(text):
            match = _TOKEN.match(text, at)
            if match is None:
                raise InputError(f"cannot read the flattened model at {text[at : at + 40]!r}")
            at = match.end()
            if match.lastgroup != "space":
                self.tokens.append((str(match.lastgroup), match.group()))
        self.tokens.append(("end", ""))
        self.at = 0

    @property
    def word(self) -> str:
        return self.tokens[self.at][1]

    @property
    def kind(self) -> str:
        return self.tokens[self.at][0]

    def next(self) -> str:
        word = self.word
        self.at += 1
        return word

    def accept(self, word: str) -> bool:
        if self.kind != "text" and self.word == word:
            self.at += 1
            return True
        return False

    def expect(self, word: str) -> None:
        if not self.accept(word):
            self.fail(f"expected {word!r}")

    def fail(self, why: str) -> None:
        context = " ".join(t for _, t in self.tokens[max(self.at - 6, 0) : self.at + 6])
        raise InputError(
            f"the flattened model has a construct that this exporter cannot translate: {context!r} ({why})"
        )

    def name(self) -> str:
        if self.kind != "name":
            self.fail("expected a name")
        return self.next()

    # expressions, weakest binding first

    def expression(self) -> Expression:
        if self.accept("if"):
            return self._if()
        first = self.disjunction()
        if self.accept(":"):
            second = self.disjunction()
            if self.accept(":"):
                return Range(first, second, self.disjunction())
            return Range(first, None, second)
        return first

    def _if(self) -> Expression:
        condition = self.expression()
        self.expect("then")
        then = self.expression()
        if self.accept("elseif"):
            return If(condition, then, self._if())
        self.expect("else")
        return If(condition, then, self.expression())

    def disjunction(self) -> Expression:
        left = self.conjunction()
        while self.accept("or"):
            left = Call("or", (left, self.conjunction()))
        return left

    def conjunction(self) -> Expression:
        left = self.negation()
        while self.accept("and"):
            left = Call("and", (left, self.negation()))
        return left

    def negation(self) -> Expression:
        return Call("not", (self.relation(),)) if self.accept("not") else self.relation()

    def relation(self) -> Expression:
        left = self.sum()
        if self.kind == "sign" and self.word in _COMPARISONS:
            operator = self.next()
            return Call(operator, (left, self.sum()))
        return left

    def sum(self) -> Expression:
        if self.kind == "sign" and self.word in ("+", "-", ".+", ".-"):
            sign = self.next()
            left = self.product()
            left = Call("neg", (left,)) if "-" in sign else left
        else:
            left = self.product()
        while self.kind == "sign" and self.word in ("+", "-", ".+", ".-"):
            operator = self.next()
            left = Call(operator, (left, self.product()))
        return left

    def product(self) -> Expression:
        left = self.power()
        while self.kind == "sign" and self.word in ("*", "/", ".*", "./"):
            operator = self.next()
            left = Call(operator, (left, self.power()))
        return left

    def power(self) -> Expression:
        base = self.primary()
        if self.kind == "sign" and self.word in ("^", ".^"):
            operator = self.next()
            return Call(operator, (base, self.primary()))
        return base

    def primary(self) -> Expression:
        if self.kind == "number":
            return Number(float(self.next()))
        if self.kind == "text":
            return Text(self.text())
        if self.accept("("):
            inner = self.expression()
            self.expect(")")
            return inner
        if self.accept("{"):
            return self._braces()
        if self.kind == "sign" and self.word in ("-", "+"):
            sign = self.next()
            inner = self.primary()
            return Call("neg", (inner,)) if sign == "-" else inner
        if self.accept("if"):
            return self._if()
        word = self.name()
        if word in ("true", "false"):
            return Number(float(word == "true"))
        if self.accept("("):
            call = self._call(word)
            subscripts = self._subscripts()
            return Index(call, subscripts) if subscripts else call
        return Name(word, self._subscripts())

    def _subscripts(self) -> tuple[Expression, ...]:
        return self._list("]") if self.accept("[") else ()

    def _list(self, close: str) -> tuple[Expression, ...]:
        items: list[Expression] = []
        while not self.accept(close):
            items.append(self.expression())
            if self.word != close:
                self.expect(",")
        return tuple(items)

    def _call(self, function: str) -> Expression:
        if self.accept(")"):
            return Call(function, ())
        first = self.expression()
        if self.accept("for"):
            return Call(function, (self._comprehension(first, ")"),))
        if self.accept(")"):
            return Call(function, (first,))
        if self.word == "=":
            self.fail("named arguments")
        self.expect(",")
        return Call(function, (first, *self._list(")")))

    def _braces(self) -> Expression:
        first = self.expression()
        if self.accept("for"):
            return self._comprehension(first, "}")
        if self.accept("}"):
            return Array((first,))
        self.expect(",")
        return Array((first, *self._list("}")))

    def _comprehension(self, item: Expression, close: str) -> Expression:
        variable = self.name()
        self.expect("in")
        values = self.expression()
        self.expect(close)
        return Comprehension(item, variable, values)

    def text(self) -> str:
        return re.sub(r"\\(.)", lambda m: _ESCAPES.get(m[1], m[1]), self.next()[1:-1], flags=re.DOTALL)

    # declarations, statements, classes

    def declaration(self) -> Declaration:
        prefixes = set()
        while self.word in _PREFIXES:
            prefixes.add(self.next())
        type_name = self.name()
        sizes = self._subscripts()
        name = self.name()
        sizes = self._subscripts() or sizes
        attributes: dict[str, Expression] = {}
        if self.accept("("):
            while not self.accept(")"):
                self.accept("each")
                key = self.name()
                self.expect("=")
                attributes[key] = self.expression()
                if self.word != ")":
                    self.expect(",")
        binding = self.expression() if self.accept("=") or self.accept(":=") else None
        description = self.text() if self.kind == "text" else ""
        self.expect(";")
        return Declaration(name, type_name, frozenset(prefixes), sizes, attributes, binding, description)

    def statements(self, *ends: str) -> tuple[Statement, ...]:
        body: list[Statement] = []
        while self.word not in ends:
            body.append(self.statement())
        return tuple(body)

    def statement(self) -> Statement:
        if self.accept("if"):
            branches = []
            otherwise: tuple[Statement, ...] = ()
            while True:
                condition = self.expression()
                self.expect("then")
                branches.append((condition, self.statements("elseif", "else", "end")))
                if not self.accept("elseif"):
                    break
            if self.accept("else"):
                otherwise = self.statements("end")
            self._end("if")
            return IfStatement(tuple(branches), otherwise)
        if self.accept("for"):
            variable = self.name()
            self.expect("in")
            values = self.expression()
            self.expect("loop")
            body = self.statements("end")
            self._end("for")
            return ForStatement(variable, values, body)
        if self.word in ("while", "when", "return", "break", "("):
            self.fail(f"the statement {self.word!r}")
        target = Name(self.name(), self._subscripts())
        self.expect(":=")
        value = self.expression()
        self.expect(";")
        return Assign(target, value)

    def _end(self, word: str) -> None:
        self.expect("end")
        self.expect(word)
        self.expect(";")

    def function(self) -> Function:
        name = self.name()
        self._description()
        declarations: list[Declaration] = []
        protected = False
        while self.word not in ("algorithm", "end"):
            if self.accept("protected"):
                protected = True
            elif self.accept("public"):
                protected = False
            elif self.word in ("external", "equation", "import", "extends"):
                self.fail(f"{self.word!r} in function {name}")
            else:
                d = self.declaration()
                prefixes = d.prefixes | {"protected"} if protected else d.prefixes
                declarations.append(
                    Declaration(d.name, d.type, prefixes, d.sizes, d.attributes, d.binding, d.description)
                )
        body = self.statements("end") if self.accept("algorithm") else ()
        self._end(name)
        return Function(name, tuple(declarations), body)

    def _description(self) -> None:
        if self.kind == "text":
            self.next()

    def equations(self) -> tuple[Equation, ...]:
        found: list[Equation] = []
        while self.word not in ("initial", "equation", "end", "algorithm"):
            if self.word in ("when", "if", "assert", "connect", "terminate", "reinit"):
                self.fail(f"a {self.word!r} equation")
            if self.accept("for"):
                variable = self.name()
                self.expect("in")
                values = self.expression()
                self.expect("loop")
                found.append(ForEquation(variable, values, self.equations()))
                self._end("for")
                continue
            left = self.expression()
            self.expect("=")
            found.append(Equal(left, self.expression()))
            self._description()
            self.expect(";")
        return tuple(found)

    def model(self) -> FlatModel:
        functions: dict[str, Function] = {}
        declarations: list[Declaration] = []
        equations: list[Equation] = []
        initial: list[Equation] = []
        if self.word not in _CLASS_WORDS:
            self.fail("expected a class")
        self.next()
        name = self.name()
        self._description()
        while not self.accept("end"):
            if self.accept("equation"):
                equations.extend(self.equations())
            elif self.accept("initial"):
                self.expect("equation")
                initial.extend(self.equations())
            elif self.word == "algorithm":
                self.fail("an algorithm section in a model")
            elif self.word in ("function", "pure", "impure"):
                self.accept("pure")
                self.accept("impure")
                self.expect("function")
                function = self.function()
                functions[function.name] = function
            elif self.word in _CLASS_WORDS:
                self.fail(f"a local {self.word}")
            else:
                declarations.append(self.declaration())
        self.expect(name)
        self.expect(";")
        if self.kind != "end":
            self.fail("text after the model")
        return FlatModel(name, tuple(declarations), tuple(equations), tuple(initial), functions)


def parse(text: str) -> FlatModel:
    """Read one flat model. Raises InputError that names the first construct outside the grammar."""
    return _Parser(text).model()
