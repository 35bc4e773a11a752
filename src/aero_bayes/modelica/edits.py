"""Edits of Modelica source that keep everything else: comments, annotations, layout."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from aero_bayes.modelica.classes import ClassText, SourceStatement
from aero_bayes.modelica.parse import Token, tokenize, words_of


@dataclass(frozen=True)
class TextEdit:
    """``text`` in place of the characters ``start`` to ``end``."""

    start: int
    end: int
    text: str

    def moved(self, by: int) -> TextEdit:
        """Return the same edit in a text that begins `by` characters earlier or, if negative, later."""
        return TextEdit(self.start + by, self.end + by, self.text)


def apply_edits(text: str, edits: Iterable[TextEdit]) -> str:
    """Return the text with all edits made. Edits at one place keep their order. Raises ValueError where two overlap."""
    pieces: list[str] = []
    at = 0
    for e in sorted(edits, key=lambda e: (e.start, e.end)):
        if e.start < at:
            raise ValueError(f"two edits overlap at {e.start}")
        pieces += [text[at : e.start], e.text]
        at = e.end
    return "".join([*pieces, text[at:]])


def unified_diff(before: str, after: str, name_before: str, name_after: str) -> str:
    """Return a diff as ``diff -u`` writes it."""
    lines = difflib.unified_diff(
        before.splitlines(keepends=True), after.splitlines(keepends=True), name_before, name_after
    )
    return "".join(line if line.endswith("\n") else line + "\n\\ No newline at end of file\n" for line in lines)


def indentation(text: str, at: int) -> str:
    """Return the white space with which the line of a position begins."""
    line = text[text.rfind("\n", 0, at) + 1 : at]
    return line[: len(line) - len(line.lstrip())]


def add_declarations(text: str, cls: ClassText, lines: Sequence[str]) -> list[TextEdit]:
    """Add lines after the last public declaration of a class, or at its beginning where there is none."""
    if not lines:
        return []
    public = [s.end for s in cls.statements if s.section == "public"]
    public += [c.end for c in cls.classes if _section_of(cls, c.start) == "public"]
    if public:
        last = max(public)
        indent = indentation(text, last)
        at = _rest_of_line(text, last, cls.close)
    else:
        at = _rest_of_line(text, cls.body, cls.close)
        indent = indentation(text, cls.start) + "  "
    return [TextEdit(at, at, "".join(f"\n{indent}{line}" if line else "\n" for line in lines))]


def add_equations(text: str, cls: ClassText, lines: Sequence[str]) -> list[TextEdit]:
    """Add lines at the end of a class's equations; an equation section is opened where there is none."""
    if not lines:
        return []
    outer = indentation(text, cls.start)
    sections = [(start, end) for name, start, end in cls.sections if name == "equation"]
    if sections:
        start, end = sections[-1]
        inside = [s.end for s in cls.statements if start <= s.start < end and not s.inside]
        # a compound equation ends after its last statement: look for the last semicolon of the section
        ends = [t.end for t in tokenize(text[start:end], start) if t.word == ";"]
        at = max([*inside, *ends], default=start)
        if 0 <= cls.annotation_start < end and at > cls.annotation_start >= start:
            at = max((e for e in ends if e <= cls.annotation_start), default=start)
        at = _rest_of_line(text, at, cls.close)
        first = next((s for s in cls.statements if start <= s.start < end and not s.inside), None)
        indent = indentation(text, first.start) if first is not None else outer + "  "
        return [TextEdit(at, at, "".join(f"\n{indent}{line}" for line in lines))]
    at = cls.annotation_start if cls.annotation_start >= 0 else cls.close
    before = text[text.rfind("\n", 0, at) + 1 : at]
    body = "".join(f"{outer}  {line}\n" for line in lines)
    if before.strip():
        return [TextEdit(at, at, f"\n{outer}equation\n{body}{outer}")]
    return [TextEdit(at - len(before), at - len(before), f"{outer}equation\n{body}")]


def insert_before_connector(
    text: str, connects: Sequence[SourceStatement], connector: str, chain: Sequence[tuple[str, str]]
) -> list[TextEdit]:
    """Put components between a connector and what it is connected with."""
    found = [(s, end) for s in connects for end in s.ends if "".join(words_of(end)) == connector]
    if not found or any(s.inside for s, _ in found):
        return []
    last = found[-1][0]
    nexts = [*(near for near, _ in chain[1:]), connector]
    pairs = zip((far for _, far in chain), nexts, strict=True)
    also = "".join(f"\n{indentation(text, last.start)}connect({far}, {to});" for far, to in pairs)
    return [*(TextEdit(end[0].start, end[-1].end, chain[0][0]) for _, end in found), TextEdit(last.end, last.end, also)]


def rename_class(cls: ClassText, name: str) -> list[TextEdit]:
    """Return a new name at the head and the end of a class."""
    edits = [TextEdit(cls.name_token.start, cls.name_token.end, name)]
    if cls.end_name is not None and cls.end_name.word == cls.name:
        edits.append(TextEdit(cls.end_name.start, cls.end_name.end, name))
    return edits


def replace_names(
    tokens: Sequence[Token], new: Callable[[str], str | None], *, functions: bool = True
) -> list[TextEdit]:
    """Replace the first part of references; names of modifiers and what follows a dot stay."""
    edits = []
    for k, token in enumerate(tokens):
        if token.kind != "name" or (k > 0 and tokens[k - 1].word == "."):
            continue
        before = k - 1
        while before > 0 and tokens[before].word in ("each", "final"):
            before -= 1
        opened = before >= 0 and tokens[before].word in ("(", ",")
        after = tokens[k + 1].word if k + 1 < len(tokens) else ""
        if opened and (after == "=" or (after == "(" and not functions)) and any(t.word == "(" for t in tokens[:k]):
            continue
        text = new(token.word)
        if text is not None:
            edits.append(TextEdit(token.start, token.end, text))
    return edits


def text_of(text: str, tokens: Sequence[Token]) -> str:
    """Return the source text from the first to the last of some tokens."""
    return text[tokens[0].start : tokens[-1].end] if tokens else ""


def _section_of(cls: ClassText, at: int) -> str:
    return next((name for name, start, end in cls.sections if start <= at < end), "")


def _rest_of_line(text: str, at: int, limit: int) -> int:
    """Step over a comment that closes the line, so that it stays with what it speaks of."""
    end = text.find("\n", at, limit)
    end = end if end >= 0 else limit
    rest = text[at:end].strip()
    whole = rest.startswith("//") or (rest.startswith("/*") and rest.endswith("*/") and rest.count("/*") == 1)
    return end if whole else at
