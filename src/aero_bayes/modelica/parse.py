"""The lexer and a recursive-descent parser of expressions of Modelica; tokens and trees have positions in the text."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

from aero_bayes.errors import InputError
from aero_bayes.modelica.syntax import (
    Array,
    Call,
    Comprehension,
    Expression,
    Field,
    If,
    Index,
    Name,
    NamedArgument,
    Number,
    RangeExpression,
    Text,
    WholeDimension,
    short_text,
)

_TOKEN = re.compile(
    r"""(?P<space>[\s\ufeff]+)
      | (?P<comment>//[^\n]*|/\*.*?\*/)
      | (?P<text>"(?:[^"\\]|\\.)*")
      | (?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)
      | (?P<name>[^\W\d]\w*|'(?:[^'\\]|\\.)*')
      | (?P<sign>:=|<=|>=|<>|==|\.\*|\./|\.\+|\.-|\.\^|[-+*/^()\[\]{},;:=<>.])""",
    re.VERBOSE | re.DOTALL,
)
_HIDDEN = re.compile(r'//[^\n]*|/\*.*?\*/|"(?:[^"\\]|\\.)*"', re.DOTALL)
_DEPTH = {"(": 1, "[": 1, "{": 1, ")": -1, "]": -1, "}": -1}


@dataclass(frozen=True)
class Token:
    """One token: ``kind`` is text, number, name or sign; ``start`` and ``end`` count characters of the source."""

    kind: str
    word: str
    start: int
    end: int


@dataclass(frozen=True)
class SourceLocation:
    """Bytes ``start`` to ``end`` of a source file, and the line (from one) that they begin on."""

    file: str
    start: int
    end: int
    line: int

    def __str__(self) -> str:
        return f"{self.file}:{self.line}"


@lru_cache(maxsize=4096)  # the same text is read at several stages; the result is immutable
def tokenize(text: str, offset: int = 0, *, strict: bool = True) -> tuple[Token, ...]:
    """Return tokens without comments and white space; ``offset`` is added to their positions."""
    found: list[Token] = []
    at = 0
    while at < len(text):
        match = _TOKEN.match(text, at)
        if match is None:
            if strict:
                raise InputError(f"line {line_of(text, at)}: cannot read {text[at : at + 20]!r} as Modelica")
            at += 1
            continue
        if match.lastgroup not in ("space", "comment"):
            found.append(Token(str(match.lastgroup), match.group(), offset + at, offset + match.end()))
        at = match.end()
    return tuple(found)


def line_of(text: str, at: int) -> int:
    """Return the number of the line that a position is on."""
    return text.count("\n", 0, at) + 1


def words_of(tokens: Sequence[Token]) -> list[str]:
    """Return the tokens as they are written."""
    return [t.word for t in tokens]


def without_comments(text: str) -> str:
    """Return the text without comments and strings, on as many lines; faster than tokens where a library is large."""
    return _HIDDEN.sub(lambda m: "\n" * m[0].count("\n"), text)


def one_line(text: str) -> str:
    """Return the text without comments, each stretch of white space one blank; strings stay as they are."""
    pieces: list[str] = []
    at = 0
    while (match := _TOKEN.match(text, at)) is not None:
        pieces.append(" " if match.lastgroup in ("space", "comment") else match.group())
        at = match.end()
    words = [p for k, p in enumerate(pieces) if p != " " or (k > 0 and pieces[k - 1] != " ")]
    return "".join([*words, text[at:]]).strip()


def skip_group(tokens: Sequence[Token], at: int, *, strict: bool = True) -> int:
    """Return index after the bracket that closes the one at ``at``."""
    depth = 0
    while at < len(tokens):
        if tokens[at].kind == "sign":
            depth += _DEPTH.get(tokens[at].word, 0)
        at += 1
        if depth == 0:
            return at
    if strict:
        raise InputError("a bracket is not closed")
    return at


def find_outside(tokens: Sequence[Token], words: frozenset[str], at: int = 0) -> int:
    """Find the first of ``words`` outside all brackets, or the number of tokens."""
    while at < len(tokens):
        token = tokens[at]
        if token.kind != "text" and token.word in words:
            return at
        at = skip_group(tokens, at) if token.word in "([{" and token.kind == "sign" else at + 1
    return at


def split_outside(tokens: Sequence[Token], word: str = ",") -> list[Sequence[Token]]:
    """Return the parts between the ``word`` tokens that stand outside all brackets; none for no tokens."""
    parts: list[Sequence[Token]] = []
    begin = 0
    while begin < len(tokens):
        end = find_outside(tokens, frozenset({word}), begin)
        parts.append(tokens[begin:end])
        begin = end + 1
    return parts


def without_indices(name: str) -> str:
    """Return the name of a component or array without what stands in brackets: ``c[1].k`` is ``c.k``."""
    return re.sub(r"\[[^\]]*\]", "", name)


_OF_MATH = (
    "sqrt", "exp", "log", "log10", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh",
)  # fmt: skip
UNARY: dict[str, Callable[[float], float]] = {
    **{name: getattr(math, name) for name in _OF_MATH},
    "abs": abs,
    "sign": lambda x: float((x > 0) - (x < 0)),
    "neg": lambda x: -x,
    "not": lambda x: float(not x),
    "floor": lambda x: float(math.floor(x)),
}

BINARY: dict[str, Callable[[float, float], float]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "pow": lambda a, b: float(a**b),
    "min": min,
    "max": max,
    "atan2": math.atan2,
    "lt": lambda a, b: float(a < b),
    "le": lambda a, b: float(a <= b),
    "gt": lambda a, b: float(a > b),
    "ge": lambda a, b: float(a >= b),
    "eq": lambda a, b: float(a == b),
    "ne": lambda a, b: float(a != b),
    "and": lambda a, b: float(bool(a) and bool(b)),
    "or": lambda a, b: float(bool(a) or bool(b)),
}

RELATIONS = frozenset({"lt", "le", "gt", "ge", "eq", "ne"})
BOOLEAN = RELATIONS | {"and", "or", "not"}
#: The operators of the language by the functions above.
OPERATORS = {
    "+": "add", "-": "sub", "*": "mul", "/": "div", "^": "pow",
    ".+": "add", ".-": "sub", ".*": "mul", "./": "div", ".^": "pow",
    "<": "lt", "<=": "le", ">": "gt", ">=": "ge", "==": "eq", "<>": "ne",
    "and": "and", "or": "or", "min": "min", "max": "max", "atan2": "atan2",
}  # fmt: skip


def evaluate_expression(tree: Expression, values: Mapping[str, float]) -> float:
    """Return the number of an expression. Raises InputError for a name without a value, or what has no number."""
    match tree:
        case Number(value):
            return value
        case Name():
            name = short_text(tree)
            if name not in values:
                raise InputError(f"{name!r} has no value here")
            return values[name]
        case If(condition, then, otherwise):
            return evaluate_expression(then if evaluate_expression(condition, values) else otherwise, values)
        case Call(function, (one,)) if function in UNARY:
            return float(UNARY[function](evaluate_expression(one, values)))
        case Call(function, (one, two)) if (operation := OPERATORS.get(function, "")) in BINARY:
            return float(BINARY[operation](evaluate_expression(one, values), evaluate_expression(two, values)))
    raise InputError(f"{short_text(tree)} is not a plain formula in sizes")


#: Operators between two operands, those that bind least first; ``not`` binds less than a relation.
_LEVELS = (
    frozenset({"or"}), frozenset({"and"}), frozenset({"<", "<=", ">", ">=", "==", "<>"}),
    frozenset({"+", "-", ".+", ".-"}), frozenset({"*", "/", ".*", "./"}), frozenset({"^", ".^"}),
)  # fmt: skip
_RELATION, _SUM, _POWER = 2, 3, 5


def parse_expression(tokens: Sequence[Token], numbers: Mapping[str, int] | None = None) -> Expression:
    """Return the tree of an expression; in it, ``numbers`` stand in the place of names."""
    reader = _ExpressionParser(tokens, numbers or {})
    tree = reader.expression()
    if reader.word:
        raise reader.fail()
    return tree


def parse_text(text: str) -> Expression:
    """Return the tree of an expression that a text holds and nothing else."""
    return parse_expression(tokenize(text))


def sides_of(tokens: Sequence[Token], numbers: Mapping[str, int] | None = None) -> tuple[Expression, Expression] | None:
    """Return both sides of an equation without description, annotation and semicolon; None where it is none."""
    at = find_outside(tokens, frozenset({"="}))
    try:
        return parse_expression(tokens[:at], numbers), parse_expression(tokens[at + 1 :], numbers)
    except InputError:
        return None


class _ExpressionParser:
    def __init__(self, tokens: Sequence[Token], numbers: Mapping[str, int]) -> None:
        self.tokens = tokens
        self.numbers = numbers
        self.at = 0

    @property
    def word(self) -> str:
        """The next token, a text with its marks; empty at the end."""
        return self.tokens[self.at].word if self.at < len(self.tokens) else ""

    def fail(self) -> InputError:
        return InputError(f"cannot read {self.word!r} in an expression" if self.word else "an expression is missing")

    def next(self) -> Token:
        if not self.word:
            raise self.fail()
        self.at += 1
        return self.tokens[self.at - 1]

    def take(self, words: Iterable[str]) -> str:
        """Return the next token where it is one of these."""
        return self.next().word if self.word and self.word in words else ""

    def need(self, word: str) -> None:
        if not self.take((word,)):
            raise self.fail()

    def span(self, begin: int) -> tuple[int, int]:
        return self.tokens[begin].start, self.tokens[self.at - 1].end

    # from what binds least to what binds most

    def expression(self) -> Expression:
        begin = self.at
        if self.take(("if", "elseif")):
            condition = self.expression()
            self.need("then")
            then = self.expression()
            if self.word == "elseif":
                otherwise = self.expression()
            else:
                self.need("else")
                otherwise = self.expression()
            return If(condition, then, otherwise, span=self.span(begin))
        parts = [self.binary(0)]
        while len(parts) < 3 and self.take(":"):
            parts.append(self.binary(0))
        if len(parts) == 1:
            return parts[0]
        return RangeExpression(parts[0], parts[1] if len(parts) == 3 else None, parts[-1], span=self.span(begin))

    def binary(self, level: int) -> Expression:
        """Return operands of one level and those above it, taken together from the left."""
        if level > _POWER:
            return self.primary()
        begin = self.at
        if level == _RELATION and self.take(("not",)):
            return Call("not", (self.binary(level),), span=self.span(begin))
        sign = self.take(_LEVELS[_SUM]) if level == _SUM else ""
        tree = self.binary(level + 1)
        if sign in ("-", ".-"):
            tree = Call("neg", (tree,), span=self.span(begin))
        while operator := self.take(_LEVELS[level]):
            tree = Call(operator, (tree, self.binary(level + 1)), span=self.span(begin))
        return tree

    def primary(self) -> Expression:
        begin = self.at
        token = self.next()
        tree: Expression
        match token.kind, token.word:
            case "number", word:
                tree = Number(float(word), span=self.span(begin))
            case "text", word:
                tree = Text(word[1:-1], span=self.span(begin))
            case "name", ("true" | "false") as word:
                tree = Number(float(word == "true"), span=self.span(begin))
            case "sign", ("-" | "+" | ".-" | ".+") as sign:  # after another operator
                tree = self.binary(_POWER)
                tree = Call("neg", (tree,), span=self.span(begin)) if sign[-1] == "-" else tree
            case ("name", _) | ("sign", "."):
                self.at = begin
                tree = self.name()
            case "sign", "(":
                items = self.items(")")
                tree = items[0] if len(items) == 1 else Array(items, span=self.span(begin))
            case "sign", "{":
                items = self.items("}")
                alone = len(items) == 1 and isinstance(items[0], Comprehension)
                tree = items[0] if alone else Array(items, span=self.span(begin))
            case "sign", "[":
                rows = [Call("[,]", self.items("];"))]
                while self.tokens[self.at - 1].word == ";":
                    rows.append(Call("[,]", self.items("];")))
                tree = Call("[;]", tuple(rows), span=self.span(begin))
            case _:
                self.at = begin
                raise self.fail()
        while not isinstance(tree, Name) and self.word in ("[", "."):
            if self.next().word == "[":
                tree = Index(tree, self.items("]"), span=self.span(begin))
            else:
                tree = Field(tree, self.next().word, span=self.span(begin))
        return tree

    def name(self) -> Expression:
        """Return a component reference, or the call of a function."""
        begin = self.at
        path = self.take(".")
        while True:
            part = self.next()
            if part.kind != "name":
                raise self.fail()
            subscripts = tuple(map(_folded, self.items("]"))) if self.take("[") else ()
            if not self.take("."):
                break
            path += short_text(Name(part.word, subscripts)) + "."
        whole = path + part.word
        if not subscripts and self.take("("):
            return Call(whole, self.items(")"), span=self.span(begin))
        if whole in self.numbers and not subscripts:
            return Number(float(self.numbers[whole]), span=self.span(begin))
        return Name(whole, subscripts, span=self.span(begin))

    def items(self, closing: str) -> tuple[Expression, ...]:
        """Return the items between commas up to the closing bracket: arguments, subscripts, elements."""
        found: list[Expression] = []
        while not self.take(closing):
            if found:
                self.need(",")
            while self.take(("each", "final")):  # in a modifier, which reads as a call
                pass
            begin = self.at
            if self.word == ":":
                self.at += 1
                found.append(WholeDimension(span=self.span(begin)))
                continue
            if [t.word for t in self.tokens[begin + 1 : begin + 2]] == ["="]:
                name = self.next().word
                self.need("=")
                found.append(NamedArgument(name, self.expression(), span=self.span(begin)))
                continue
            item = self.expression()
            if self.take(("for",)):
                item = self.loops(item, begin)
            found.append(item)
        return tuple(found)

    def loops(self, item: Expression, begin: int) -> Expression:
        """Read ``item for i in values, j in others``; the first variable is that of the inner loop."""
        while True:
            variable = self.next().word
            self.need("in")
            item = Comprehension(item, variable, self.expression(), span=self.span(begin))
            if not self.take(","):
                return item


def _folded(subscript: Expression) -> Expression:
    """Return a subscript such as ``2 + 1`` as the number that it is."""
    try:
        return Number(evaluate_expression(subscript, {}), span=subscript.span)
    except InputError:
        return subscript
