"""The added term in the model's equations, and the difference of the two models."""

from __future__ import annotations

import re
from difflib import SequenceMatcher

from markupsafe import Markup, escape

from aero_bayes.report.schema_run import LoopJson

#: What begins a part of a class that holds no equations; the text of a documentation is none either.
NO_EQUATIONS = ("end ", "public", "protected", "algorithm", "annotation")


def changed_equations(loop: LoopJson) -> Markup | None:
    """Equations of the extended model that the base model has not, with what is new in them marked; None if there are
    none.
    """
    section, own = False, set()
    for text in loop.modelica_source.splitlines():
        head = text.strip().removeprefix("initial ")
        section = (section or head == "equation") and not head.startswith(NO_EQUATIONS)
        own |= {head} if section and head != "equation" else set()
    old: list[str] = []
    found = []
    for text in loop.diff.splitlines():
        kind, line = _diff_kind(text), text[1:].strip()
        if kind == "add" and line in own and not line.startswith("//"):
            found.append(_marked(old.pop(0) if old else "", line))
        elif kind != "add":
            old = [*old, line] if kind == "del" else []
    return Markup("\n").join(found) if found else None


def _marked(old: str, new: str) -> Markup:
    """Return a line with the differences to an older one marked."""
    before, after = (re.findall(r"[\w.]+|\s+|.", text) for text in (old, new))
    shown = Markup("")
    for kind, _, _, start, stop in SequenceMatcher(None, before, after, autojunk=False).get_opcodes():
        text = "".join(after[start:stop])
        shown += escape(text) if kind == "equal" or not text else Markup("<mark>{}</mark>").format(text)
    return shown


def diff_lines(loop: LoopJson) -> list[tuple[str, str]]:
    """Return lines of the Modelica diff with their kind: add, del, hunk or same."""
    return [(_diff_kind(entry), entry) for entry in loop.diff.splitlines()]


def _diff_kind(entry: str) -> str:
    if entry.startswith(("+++", "---", "@@")):
        return "hunk"
    return {"+": "add", "-": "del"}.get(entry[:1], "same")
