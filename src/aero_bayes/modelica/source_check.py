"""Refuses Modelica source that rumoca drops without a message, and arrays so large that it never ends."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path

from aero_bayes.errors import InputError
from aero_bayes.modelica.classes import CLASS_WORDS, dotted_name
from aero_bayes.modelica.library import rig_packages
from aero_bayes.modelica.tokens import Token, line_of, skip_group, tokenize, words_of

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


def _sections(text: str) -> Iterator[tuple[Token, str]]:
    """Yield the algorithm sections that are in no function, each with its text."""
    tokens = _tokens(text)
    inside = False
    for at, token in enumerate(tokens):
        before, after = words_of(tokens[max(at - 1, 0) : at]), words_of(tokens[at + 1 : at + 2])
        short = words_of(tokens[at + 2 : at + 3]) == ["="]
        if token.word in CLASS_WORDS and before != ["end"] and not short:
            inside = token.word == "function"
        elif token.word == "end" and inside and after and after[0] not in ("if", "for", "while", "when"):
            inside = False
        elif token.word == "algorithm" and not inside:
            yield token, text[token.start :]


def _derivatives(text: str) -> Iterator[tuple[Token, str]]:
    """Yield where ``der`` stands, with what is in its parentheses."""
    tokens = _tokens(text)
    for at, token in enumerate(tokens):
        if token.word == "der" and words_of(tokens[at + 1 : at + 2]) == ["("]:
            end = skip_group(tokens, at + 1, strict=False) - 1
            yield token, text[tokens[at + 1].end : tokens[end].start].strip()


def explain(message: str, model: str, root: Path) -> str:
    """Return what to write instead of a construct that rumoca does not read, with ``file:line``, else the message."""
    span = re.search(r"BytePos\((\d+)\)", message)
    quoted = re.search(r"read of `([^`]+)`", message)
    for path in _likely(model, root):
        text = path.read_text(encoding="utf-8", errors="replace")
        place = f"{path.relative_to(root)}:"
        if "model algorithm" in message:
            for token, body in _sections(text):
                if quoted is None or re.search(rf"\b{re.escape(quoted[1])}\s*:=", body):
                    what = "an algorithm section that assigns a variable twice, or has a loop, is not read"
                    return f"{place}{line_of(text, token.start)}: {what}; put it into a function and call that"
        elif "der(...)" in message:
            begin = len(text.encode()[: int(span[1])].decode(errors="replace")) if span is not None else None
            for token, of in _derivatives(text):
                if token.start == begin:
                    what = f"the derivative of {of!r} is not known, since it is no state; make it an input of its own"
                    return f"{place}{line_of(text, token.start)}: {what}"
                if begin is None and not re.fullmatch(r"[\w.\[\], ]+", of):
                    what = f"the derivative of an expression is not read; declare a variable z = {of}, and write der(z)"
                    return f"{place}{line_of(text, token.start)}: {what}"
    return message


def locate(message: str, model: str, root: Path) -> str:
    """Return the message with ``file:line`` before it: of a name that it quotes, else of the class."""
    message = explain(message, model, root)
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
