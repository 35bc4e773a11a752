"""A law as one class that needs no library: its own text and that of its partial model put together."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from aero_bayes.language.classes import ClassText, Component, Statement
from aero_bayes.language.edits import Edit, apply, indentation, replace_names
from aero_bayes.language.parse import parse_expression, parse_text
from aero_bayes.language.syntax import summands
from aero_bayes.language.tokens import one_line
from aero_bayes.language.values import evaluate
from aero_bayes.physics.laws import STANDING, Law


def class_text(
    law: Law,
    name: str,
    *,
    sizes: Mapping[str, float],
    signals: Mapping[str, str],
    without: frozenset[str] = frozenset(),
    declarations: Sequence[str] = (),
    equations: Sequence[str] = (),
) -> list[str]:
    """The lines of a model ``name`` that does what the law says.

    Parameters
    ----------
    law : Law
        Its class must extend its partial model directly.
    name : str
        Name of the class.
    sizes : mapping
        Values of the sizes; those that are not given keep their default.
    signals : mapping
        Expressions for given signals, which become variables; the others stay inputs.
    without : frozenset of str
        Outputs and parameters of the partial model that are left out with the equations that give them.
    declarations, equations : sequence of str
        Further lines, such as connectors.
    """
    used = _used(law, without)
    lines = [f'model {name} "{law.description}"', *(f"  {d}" for d in declarations)]
    public: list[str] = []
    hidden: list[str] = []
    laws: list[str] = []
    starts: list[str] = []
    for cls, text in ((law.base, law.base_text), (law.cls, law.text)):
        offset = law.cls.start if cls is law.cls else 0
        for statement, components in _declared(cls):
            if not components or any(c.name in without for c in components):
                continue
            if cls is law.base and not any(c.name in used for c in components):
                continue
            line = _line(text, statement, components, sizes, signals, offset)
            (hidden if statement.section == "protected" else public).append(line)
        for s in cls.equations:
            if not any(t.word in without for t in s.tokens):
                laws.append(one_line(text[s.start - offset : s.end - offset]))
        initial = (s for s in cls.statements if s.section == "initial equation")
        starts += [one_line(text[s.start - offset : s.end - offset]) for s in initial]
    lines += [f"  {line}" for line in public]
    if hidden:
        lines += ["protected", *(f"  {line}" for line in hidden)]
    if starts:
        lines += ["initial equation", *(f"  {line}" for line in starts)]
    lines += ["equation", *(f"  {line}" for line in (*equations, *laws))]
    note = _documentation(law)
    lines += [f"  {line}" for line in note]
    return [*lines, f"end {name};"]


def formula(law: Law, *, sizes: Mapping[str, float], names: Mapping[str, str]) -> str | None:
    """What the law gives as one expression, where its class says no more than that.

    Parameters
    ----------
    law : Law
    sizes : mapping
        Values of all sizes; what follows from them alone becomes a number.
    names : mapping
        What stands for the law's given signals and parameters.

    Returns
    -------
    str or None
        None for a law with several equations or variables of its own.
    """
    if len(law.cls.equations) != 1 or law.base.equations:
        return None
    (equation,) = law.cls.equations
    core = equation.core
    if [t.word for t in core[:2]] != [law.shape.acts, "="] or any(t.word == "der" for t in core):
        return None
    values = {k: float(v) for k, v in sizes.items()}
    for c in law.cls.components():
        if "final" in c.prefixes:
            values[c.name] = evaluate(parse_expression(c.binding), values)
        elif c.name not in names:
            return None
    numbers = {k: f"{v:.12g}" if v >= 0.0 else f"({v:.12g})" for k, v in values.items()}
    known = {**numbers, **{signal: numbers[size] for signal, size in STANDING.items() if size in numbers}, **names}
    begin, end = core[2].start - law.cls.start, core[-1].end - law.cls.start
    edits = [e.moved(-core[2].start) for e in replace_names(core[2:], known.get)]
    text = re.sub(r"- \(-([\w.]+)\)", r"+ \1", one_line(apply(law.text[begin:end], edits)))
    text = re.sub(r"(?<!\w)\(([\w.]+) - 0\)", r"\1", text)
    text = re.sub(r"\(([\w.]+) - 0\)", r"(\1)", text)
    tree = parse_text(text)
    return text if summands(tree) == [(1, tree)] else f"({text})"


def _declared(cls: ClassText) -> list[tuple[Statement, list[Component]]]:
    every = cls.components()
    return [(s, [c for c in every if c.statement is s]) for s in cls.declarations]


def _used(law: Law, without: frozenset[str]) -> set[str]:
    """Names of the partial model that the law's text needs, directly or through each other."""
    own = {t.word for s in law.cls.statements for t in s.tokens if t.kind == "name" and s.first != "extends"}
    own.add(law.shape.acts)
    own |= {t.word for s in law.base.equations for t in s.tokens if not any(u.word in without for u in s.tokens)}
    return own - without


def _line(
    text: str,
    statement: Statement,
    components: Sequence[Component],
    sizes: Mapping[str, float],
    signals: Mapping[str, str],
    offset: int,
) -> str:
    edits: list[Edit] = []
    # what the program sets and what follows from that alone is no parameter to tune
    if any(c.name in sizes or "final" in c.prefixes for c in components):
        first = next(t for t in statement.tokens if t.word in ("final", "parameter"))
        last = next(t for t in statement.tokens if t.word == "parameter")
        edits.append(Edit(first.start - offset, last.end - offset, "constant"))
    for c in components:
        value = signals.get(c.name, repr(float(sizes[c.name])) if c.name in sizes else None)
        if value is None:
            continue
        if c.name in signals:
            word = next(t for t in statement.tokens if t.word == "input")
            edits.append(Edit(word.start - offset, word.end - offset + 1, ""))
        if c.binding:
            edits.append(Edit(c.binding[0].start - offset, c.binding[-1].end - offset, value))
        else:
            end = (c.arguments[-1] if c.arguments else c.name_token).end - offset
            edits.append(Edit(end, end, f" = {value}"))
    start, end = statement.start - offset, statement.end - offset
    moved = [Edit(e.start - start, e.end - start, e.text) for e in edits]
    return one_line(apply(text[start:end], moved))


def _documentation(law: Law) -> list[str]:
    if not law.cls.annotation:
        return []
    start = law.cls.annotation_start - law.cls.start
    end = law.cls.annotation[-1].end - law.cls.start
    text = law.text[start:end]
    indent = indentation(law.text, start)
    lines = text.split("\n")
    return [line.removeprefix(indent) for line in lines[:-1]] + [lines[-1].removeprefix(indent) + ";"]
