"""A class with the declarations and equations of its base classes inlined, so that a copy of them can be edited."""

from __future__ import annotations

import re
from collections.abc import Sequence

from aero_bayes.errors import InputError
from aero_bayes.language.class_reader import read_classes
from aero_bayes.language.classes import ClassText, ComponentDeclaration, SourceStatement
from aero_bayes.language.edits import TextEdit, add_equations, apply_edits, replace_names
from aero_bayes.language.sources import SourceFile, Sources
from aero_bayes.language.tokens import Token, find_outside, one_line, skip_group, split_outside


def inline_base_classes(known: Sources, file: SourceFile, cls: ClassText) -> tuple[SourceFile, ClassText]:
    """Write a file of ``cls`` alone, with declarations and equations of base classes in place of ``extends``.

    Names that mean something in the packages around a class are given in full."""
    text = standalone_text(known, file, cls)
    (own,) = read_classes(text)
    for clause in [s for s in own.declarations if s.first == "extends"]:
        (own,) = read_classes(text)
        name, arguments = _clause(clause)
        base_file, base = known.find(known.resolve(cls, name))
        inner_file, inner = inline_base_classes(known, base_file, base)
        if inner.classes:
            raise InputError(f"{base.full_name}: a base class with classes of its own cannot be written out")
        current = next(s for s in own.declarations if s.first == "extends")
        declared = _declarations(inner_file.text, inner, arguments)
        edits = [TextEdit(current.start, current.end, "\n  ".join(declared))]
        stated = _whole(inner)
        lines = {k: [one_line(inner_file.text[s.start : s.end]) for s in v] for k, v in stated.items()}
        edits += add_equations(text, own, lines["equation"])
        if lines["initial equation"]:
            at = own.annotation_start if own.annotation_start >= 0 else own.close
            edits.append(
                TextEdit(at, at, "\n".join(["initial equation", *(f"  {k}" for k in lines["initial equation"]), ""]))
            )
        text = apply_edits(text, edits)
    (own,) = read_classes(text)
    own.within = ""
    return SourceFile(file.file, text, (own,)), own


def standalone_text(known: Sources, file: SourceFile, cls: ClassText) -> str:
    """Return the text of a class outside its package, moved to the margin, with names that still mean the same."""
    own = {c.name for c in cls.components()} | set(cls.class_names)
    meanings = {k: v for k, v in known.meanings(cls).items() if k not in own}
    begin = file.text.rfind("\n", 0, cls.start) + 1
    margin = file.text[begin : cls.start] if not file.text[begin : cls.start].strip() else ""
    changed: list[TextEdit] = []
    for inner in cls.walk():
        local = {c.name for c in inner.components()} | set(inner.class_names)
        outer = {k: v for k, v in meanings.items() if k not in local}
        for s in inner.statements:
            names = {c.name_token.start for c in inner.declared_in(s)}
            changed += [e for e in replace_names(s.tokens, outer.get) if e.start not in names]
    body = apply_edits(file.text[begin : cls.end], [e.moved(-begin) for e in changed])
    return re.sub(rf"^{margin}", "", body, flags=re.MULTILINE) + "\n" if margin else body + "\n"


def _clause(clause: SourceStatement) -> tuple[str, Sequence[Token]]:
    """Return the name and the modifiers of an extends clause."""
    at = find_outside(clause.core, frozenset({"("}), 1)
    name = "".join(t.word for t in clause.core[1:at])
    return name, clause.core[at + 1 : skip_group(clause.core, at) - 1] if at < len(clause.core) else ()


def _whole(cls: ClassText) -> dict[str, list[SourceStatement]]:
    """Return equations by their section."""
    if any(s.inside or s.section.endswith("algorithm") for s in cls.statements):
        raise InputError(f"{cls.name}: a base class with branches or algorithms cannot be written out")
    return {name: [s for s in cls.statements if s.section == name] for name in ("equation", "initial equation")}


def _declarations(text: str, cls: ClassText, arguments: Sequence[Token]) -> list[str]:
    """Return the declarations of a base class with the modifiers of the clause that extends it."""
    modifiers: dict[str, Sequence[Token]] = {}
    for part in split_outside(arguments):
        while part[0].word in ("each", "final"):
            part = part[1:]
        if part[0].word in ("redeclare", "replaceable") or part[0].kind != "name":
            raise InputError(f"{cls.name}: the modifier {part[0].word!r} of a base class cannot be written out")
        modifiers[part[0].word] = part[1:]
    # short class definitions, such as replaceable models
    lines, section = [text[s.start : s.end] for s in cls.statements if s.section == "class"], "public"
    for s in cls.declarations:
        if s.section != section:
            lines.append(s.section)
            section = s.section
        edits = [e for c in cls.declared_in(s) for e in _modified(c, modifiers.pop(c.name, ()))]
        lines.append(apply_edits(text[s.start : s.end], [e.moved(-s.start) for e in edits]))
    if modifiers:
        raise InputError(f"{cls.name}: the modifier of {next(iter(modifiers))!r} cannot be written out")
    return lines if section == "public" else [*lines, "public"]


def _modified(c: ComponentDeclaration, modifier: Sequence[Token]) -> list[TextEdit]:
    """Return edits of a declaration by what follows its name in a modifier: ``(start = 1) = 2``."""
    edits: list[TextEdit] = []
    at = 0
    after = (c.arguments[-1] if c.arguments else c.name_token).end
    if modifier and modifier[0].word == "(":
        at = skip_group(modifier, 0)
        inner = {p[0].word: _words(p) for p in split_outside(modifier[1 : at - 1])}
        old = {p[0].word: _words(p) for p in split_outside(c.arguments[1:-1])}
        text = f"({', '.join({**old, **inner}.values())})"
        start = c.arguments[0].start if c.arguments else after
        edits.append(TextEdit(start, after, text))
    if at < len(modifier) and modifier[at].word == "=":
        value = _words(modifier[at + 1 :])
        if c.binding:
            edits.append(TextEdit(c.binding[0].start, c.binding[-1].end, value))
        elif edits:
            edits = [TextEdit(edits[0].start, edits[0].end, f"{edits[0].text} = {value}")]
        else:
            edits.append(TextEdit(after, after, f" = {value}"))
    return edits


def _words(tokens: Sequence[Token]) -> str:
    return " ".join(t.word for t in tokens).replace(" . ", ".").replace(" (", "(").replace("( ", "(").replace(" )", ")")
