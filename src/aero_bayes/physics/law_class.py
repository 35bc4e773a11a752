"""A law as one class that needs no library: its own text and that of its partial model put together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from aero_bayes.physics.classes import ClassText, Component, Statement
from aero_bayes.physics.edit import Edit, apply, indentation
from aero_bayes.physics.laws import Law


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
                laws.append(_clean(text[s.start - offset : s.end - offset]))
    lines += [f"  {line}" for line in public]
    if hidden:
        lines += ["protected", *(f"  {line}" for line in hidden)]
    lines += ["equation", *(f"  {line}" for line in (*equations, *laws))]
    note = _documentation(law)
    lines += [f"  {line}" for line in note]
    return [*lines, f"end {name};"]


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
    return _clean(apply(text[start:end], moved))


def _clean(text: str) -> str:
    return " ".join(text.split())


def _documentation(law: Law) -> list[str]:
    if not law.cls.annotation:
        return []
    start = law.cls.annotation_start - law.cls.start
    end = law.cls.annotation[-1].end - law.cls.start
    text = law.text[start:end]
    indent = indentation(law.text, start)
    lines = text.split("\n")
    return [line.removeprefix(indent) for line in lines[:-1]] + [lines[-1].removeprefix(indent) + ";"]
