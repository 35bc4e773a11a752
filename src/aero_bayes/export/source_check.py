"""Looks at Modelica source text for what rumoca drops without a word."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path

from aero_bayes.errors import InputError
from aero_bayes.export.library import rig_packages

_HIDDEN = re.compile(r'//[^\n]*|/\*.*?\*/|"(?:[^"\\]|\\.)*"', re.DOTALL)
_KIND = r"(?:model|block|class|package|record|connector|type|function)"
_DROPPED = (
    (
        re.compile(rf"\bredeclare\s+(?:(?:final|each|replaceable)\s+)*{_KIND}\s+(\w+)\s*=\s*[\w.]+\s*\(\s*[^)\s]"),
        "modifiers of the redeclared class {0!r} would be dropped; give them at the component that uses it",
    ),
    (
        re.compile(r"\bconstrainedby\s+([\w.]+)\s*\(\s*[^)\s]"),
        "modifiers of the constraining class {0!r} would be dropped; give them at the declaration",
    ),
    (
        re.compile(r"\bextends\s+([\w.]+)\s*\((?:[^;]*?[(,])?\s*break\b"),
        "'break' in the modification of {0!r} would be ignored",
    ),
)


def _plain(path: Path) -> str:
    """Text with comments, strings and annotations blanked, so that positions stay."""
    text = path.read_text(encoding="utf-8", errors="replace")
    text = _HIDDEN.sub(lambda m: re.sub(r"[^\n]", " ", m.group()), text)
    return _blank_calls(text, re.compile(r"\bannotation\s*\("))


def _blank_calls(text: str, opening: re.Pattern[str]) -> str:
    while (match := opening.search(text)) is not None:
        depth, at = 1, match.end()
        while at < len(text) and depth:
            depth += {"(": 1, ")": -1}.get(text[at], 0)
            at += 1
        text = text[: match.start()] + re.sub(r"[^\n]", " ", text[match.start() : at]) + text[at:]
    return text


def _sources(root: Path) -> Iterator[Path]:
    yield from sorted(root.rglob("*.mo"))


def _line(text: str, at: int) -> int:
    return text.count("\n", 0, at) + 1


def refuse_dropped(root: Path, sources: Iterable[Path]) -> None:
    """Raise InputError, with file and line, where one of the sources has a construct that rumoca would drop."""
    for path in sources:
        text = _plain(path)
        for pattern, message in _DROPPED:
            match = pattern.search(text)
            if match is not None:
                where = f"{path.relative_to(root)}:{_line(text, match.start())}"
                raise InputError(f"{where}: {message.format(match[1])}")


def _likely(model: str, root: Path) -> list[Path]:
    """The user's own files, then the one that is named like the model."""
    files = list(_sources(root))
    shipped = {folder.name for folder in rig_packages()}
    own = [p for p in files if p.relative_to(root).parts[0] not in shipped]
    return [*own, *(p for p in files if p.stem == model.rpartition(".")[2])]


def locate(message: str, model: str, root: Path) -> str:
    """The message with ``file:line`` before it, where a name that it quotes stands in the likely sources."""
    for quoted in re.findall(r"['`]([^'`]+)['`]", message):
        for path in _likely(model, root):
            text = _plain(path)
            at = re.search(rf"(?<![\w.]){re.escape(quoted)}(?![\w.])", text)
            if at is not None:
                return f"{path.relative_to(root)}:{_line(text, at.start())}: {message}"
    return message
