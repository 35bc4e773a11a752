"""The text of a law as one class that needs no library: its own and that of its partial model together."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence

from aero_bayes.language.classes import ComponentDeclaration, SourceStatement
from aero_bayes.language.edits import TextEdit, apply_edits, indentation, replace_names, text_of
from aero_bayes.language.parse import parse_expression, parse_text
from aero_bayes.language.syntax import summands
from aero_bayes.language.tokens import one_line, words_of
from aero_bayes.language.values import evaluate_expression
from aero_bayes.laws.law import SIGNAL_DEFAULTS, Law


def class_text(
    law: Law,
    name: str,
    *,
    nominals: Mapping[str, float],
    signals: Mapping[str, str],
    without: frozenset[str] = frozenset(),
    declarations: Sequence[str] = (),
    equations: Sequence[str] = (),
) -> list[str]:
    """Return the lines of a model ``name`` that is the law."""
    text, cls = law.text, law.cls
    found: dict[str, list[str]] = {"public": [], "protected": [], "initial equation": [], "equation": [*equations]}
    kept = [s for s in cls.statements if s.section in found and without.isdisjoint(words_of(s.tokens))]
    used = Counter(word for s in kept for word in {t.word for t in s.tokens if t.kind == "name"})
    for s in kept:
        components = cls.declared_in(s)
        if components and not any(used[c.name] > 1 or c.name == law.interface.output for c in components):
            continue
        edits = _edits(s, components, nominals, signals)
        # a required unit of a law is that of the port, where it may be spelled otherwise
        asked = [c.arguments for c in components if c.name in law.required_units and c.arguments]
        edits += [TextEdit(tokens[0].start, tokens[-1].end, "") for tokens in asked]
        found[s.section].append(one_line(apply_edits(text[s.start : s.end], [e.moved(-s.start) for e in edits])))
    lines = [f'model {name} "{law.description}"', *(f"  {line}" for line in (*declarations, *found.pop("public")))]
    for section, inside in found.items():
        lines += [section, *(f"  {line}" for line in inside)] if inside else []
    return [*lines, *(f"  {line}" for line in _documentation(law)), f"end {name};"]


def formula(law: Law, *, nominals: Mapping[str, float], names: Mapping[str, str]) -> str | None:
    """Return the output of a law as one expression, if its class has a single explicit equation."""
    if len(law.cls.equations) != 1:
        return None
    (equation,) = law.cls.equations
    core = equation.core
    if [t.word for t in core[:2]] != [law.interface.output, "="] or any(t.word == "der" for t in core):
        return None
    values = {k: float(v) for k, v in nominals.items()}
    for c in law.cls.components():
        if "final" in c.prefixes:
            values[c.name] = evaluate_expression(parse_expression(c.binding), values)
        elif c.name not in (*names, *nominals, *law.interface.inputs, law.interface.output):
            return None
    numbers = {k: f"{v:.12g}" if v >= 0.0 else f"({v:.12g})" for k, v in values.items()}
    known = {
        **numbers,
        **{signal: numbers[nominal] for signal, nominal in SIGNAL_DEFAULTS.items() if nominal in numbers},
        **names,
    }
    edits = [e.moved(-core[2].start) for e in replace_names(core[2:], known.get)]
    text = re.sub(r"- \(-([\w.]+)\)", r"+ \1", one_line(apply_edits(text_of(law.text, core[2:]), edits)))
    text = re.sub(r"(?<!\w)\(([\w.]+) - 0\)", r"\1", text)
    text = re.sub(r"\(([\w.]+) - 0\)", r"(\1)", text)
    tree = parse_text(text)
    return text if summands(tree) == [(1, tree)] else f"({text})"


def _edits(
    statement: SourceStatement,
    components: Sequence[ComponentDeclaration],
    nominals: Mapping[str, float],
    signals: Mapping[str, str],
) -> list[TextEdit]:
    """Return edits that set nominal values and inputs in a declaration."""
    edits: list[TextEdit] = []
    # nominal values, and final parameters that follow from them, are not to be tuned
    if any(c.name in nominals or "final" in c.prefixes for c in components):
        first = next(t for t in statement.tokens if t.word in ("final", "parameter"))
        last = next(t for t in statement.tokens if t.word == "parameter")
        edits.append(TextEdit(first.start, last.end, "constant"))
    for c in components:
        value = signals.get(c.name, repr(float(nominals[c.name])) if c.name in nominals else None)
        if value is None:
            continue
        if c.name in signals:
            word = next(t for t in statement.tokens if t.word == "input")
            edits.append(TextEdit(word.start, word.end + 1, ""))
        if c.binding:
            edits.append(TextEdit(c.binding[0].start, c.binding[-1].end, value))
        else:
            end = (c.arguments[-1] if c.arguments else c.name_token).end
            edits.append(TextEdit(end, end, f" = {value}"))
    return edits


def _documentation(law: Law) -> list[str]:
    if not law.cls.annotation:
        return []
    indent = indentation(law.text, law.cls.annotation_start)
    lines = text_of(law.text, law.cls.annotation).split("\n")
    return [line.removeprefix(indent) for line in lines[:-1]] + [lines[-1].removeprefix(indent) + ";"]
