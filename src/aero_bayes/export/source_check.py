"""Refuses Modelica source that rumoca drops without a message, and arrays so large that it never ends."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path

from aero_bayes.errors import InputError
from aero_bayes.export.library import rig_packages
from aero_bayes.language.classes import CLASS_WORDS, dotted_name
from aero_bayes.language.tokens import Token, line_of, skip_group, tokenize, words_of

#: Elements of an array at most.
LARGEST = 100_000


def _tokens(text: str) -> list[Token]:
    """Return the tokens of a source without its annotations."""
    found, at, tokens = [], 0, tokenize(text, strict=False)
    while at < len(tokens):
        if words_of(tokens[at : at + 2]) == ["annotation", "("]:
            at = skip_group(tokens, at + 1, strict=False)
        else:
            found.append(tokens[at])
            at += 1
    return found


def _modifiers(tokens: Sequence[Token]) -> Sequence[Token]:
    """Return the modifiers in parentheses after the name of a class."""
    at = dotted_name(tokens)[1]
    opened = words_of(tokens[at : at + 1]) == ["("]
    return tokens[at + 1 : skip_group(tokens, at, strict=False) - 1] if opened else ()


def _large(word: str) -> bool:
    return word.isdecimal() and int(word) > LARGEST


def _dropped(tokens: Sequence[Token]) -> Iterator[tuple[Token, str]]:
    """Tokens at which rumoca would drop something or not end, and the message for each."""
    for at, token in enumerate(tokens):
        rest = tokens[at + 1 :] if token.word in ("redeclare", "constrainedby", "extends") else ()
        modifiers = _modifiers(rest)
        name = dotted_name(rest)[0]
        if token.word == "redeclare":
            begin = next((k for k, t in enumerate(rest) if t.word not in ("final", "each", "replaceable")), 0)
            kind, own, equals = [*words_of(rest[begin : begin + 3]), "", "", ""][:3]
            if kind in CLASS_WORDS and equals == "=" and _modifiers(rest[begin + 3 :]):
                what = f"modifiers of the redeclared class {own!r} would be dropped"
                yield token, f"{what}; give them at the component that uses it"
        elif token.word == "constrainedby" and modifiers:
            what = f"modifiers of the constraining class {name!r} would be dropped"
            yield token, f"{what}; give them at the declaration"
        elif token.word in ("[", ":") and (size := words_of(tokens[at + 1 : at + 2])) and _large(size[0]):
            yield token, f"an array or a loop of {size[0]} elements; at most {LARGEST} can be exported"
        elif "break" in words_of(modifiers):
            yield token, f"'break' in the modification of {name!r} would be ignored"


def refuse_dropped(root: Path, sources: Iterable[Path]) -> None:
    """Raise InputError, with file and line, where one of the sources has a construct that rumoca would drop."""
    for path in sources:
        text = path.read_text(encoding="utf-8", errors="replace")
        for token, message in _dropped(_tokens(text)):
            raise InputError(f"{path.relative_to(root)}:{line_of(text, token.start)}: {message}")


def _likely(model: str, root: Path) -> list[Path]:
    """Return the user's own files, then the one that is named like the model."""
    files = sorted(root.rglob("*.mo"))
    shipped = {folder.name for folder in rig_packages()}
    own = [p for p in files if p.relative_to(root).parts[0] not in shipped]
    return [*own, *(p for p in files if p.stem == model.rpartition(".")[2])]


def locate(message: str, model: str, root: Path) -> str:
    """Return the message with ``file:line`` before it: of a name that it quotes, else of the class."""
    if re.match(r"[^ :]+\.mo:\d+: ", message):
        return message
    for quoted in re.findall(r"['`]([^'`]+)['`]", message):
        wanted = words_of(tokenize(quoted, strict=False))
        for path in _likely(model, root):
            text = path.read_text(encoding="utf-8", errors="replace")
            tokens = _tokens(text)
            words = ["", *words_of(tokens), ""]
            for at, token in enumerate(tokens):
                whole = "." not in (words[at], words[at + 1 + len(wanted)] if at + len(wanted) < len(words) - 1 else "")
                if wanted and words[at + 1 : at + 1 + len(wanted)] == wanted and whole:
                    return f"{path.relative_to(root)}:{line_of(text, token.start)}: {message}"
    name = model.rpartition(".")[2]
    for path in _likely(model, root):  # no name, or none that stands there: the class itself
        text = path.read_text(encoding="utf-8", errors="replace")
        for token, following in pairwise(_tokens(text)):
            if token.word in CLASS_WORDS and following.word == name:
                return f"{path.relative_to(root)}:{line_of(text, token.start)}: {message}"
    return message
