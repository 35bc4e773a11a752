"""The lexer: Modelica source as tokens with their positions, and locations in files."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

from aero_bayes.errors import InputError

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
