"""Replaceable models of a Modelica system, which a redeclaration can replace by a law."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from aero_bayes.errors import InputError
from aero_bayes.language.classes import ClassText, ComponentDeclaration, SourceStatement, dotted_name
from aero_bayes.language.sources import SourceFile, Sources
from aero_bayes.language.tokens import SourceLocation, find_outside, split_outside


@dataclass(frozen=True)
class CombinationRule:
    """How several laws are combined in one replaceable model.

    All laws get the inputs and parameters in ``handed``, and are connected in parallel at the connectors in ``shared``.
    They are connected in series at the two connectors in ``series``, or by the input and output in ``signal``."""

    handed: tuple[str, ...] = ()
    shared: tuple[str, ...] = ()
    series: tuple[str, str] | None = None
    signal: tuple[str, str] | None = None


@dataclass(frozen=True)
class ReplaceableModel:
    """A replaceable model of a system."""

    name: str
    description: str
    constraint: str
    default: str
    components: tuple[str, ...]
    place: SourceLocation
    combination: CombinationRule | None


def find_replaceable_models(known: Sources, model: str) -> tuple[ReplaceableModel, ...]:
    """Find replaceable models with components, of a model and the classes that it extends."""
    try:
        chain = known.lineage(*known.find(model))
    except InputError:
        return ()
    found: dict[str, ReplaceableModel] = {}
    for file, cls in chain:
        for statement in cls.statements:
            read = _declared(known, file, cls, statement)
            if read is not None and read.name not in found:
                found[read.name] = replace(read, components=tuple(_components(known, chain, read.name)))
    return tuple(one for one in found.values() if one.components)


def _declared(known: Sources, file: SourceFile, cls: ClassText, s: SourceStatement) -> ReplaceableModel | None:
    """Return a statement ``replaceable model Name = Default constrainedby Partial "description"``.

    None for any other."""
    words = [t.word for t in s.tokens]
    kind = next((k for k in ("model", "block") if k in words[:4]), "")
    if s.section != "class" or "replaceable" not in words[:3] or not kind:
        return None
    at = words.index(kind) + 1
    if words[at + 1 : at + 2] != ["="]:
        return None
    default = known.resolve(cls, dotted_name(s.tokens[at + 2 :])[0])
    limit = find_outside(s.tokens, frozenset({"constrainedby"}))
    constraint = known.resolve(cls, dotted_name(s.tokens[limit + 1 :])[0]) if limit < len(words) else default
    end = find_outside(s.tokens, frozenset({"annotation"}))
    description = "".join(t.word[1:-1] for t in s.tokens[:end] if t.kind == "text")
    before = file.text[: s.start]
    start, stop = len(before.encode()), len(file.text[: s.end].encode())
    place = SourceLocation(file.file, start, stop, before.count("\n") + 1)
    return ReplaceableModel(words[at], description, constraint, default, (), place, _join(known, constraint, default))


def _components(known: Sources, chain: Sequence[tuple[SourceFile, ClassText]], name: str) -> Iterator[str]:
    """Yield paths of the components of a replaceable model, also where it is passed on by a redeclaration."""
    for _, cls in reversed(chain):
        for c in cls.components():
            if c.type == name:
                yield c.name
            for inner in _passed(c, name):
                try:
                    deeper = known.lineage(*known.find(known.resolve(cls, c.type)))
                except InputError:
                    continue
                yield from (f"{c.name}.{path}" for path in _components(known, deeper, inner))


def _passed(c: ComponentDeclaration, name: str) -> list[str]:
    """Return replaceable models of the class of a component that are redeclared as ``name``."""
    parts = [[t.word for t in part] for part in split_outside(c.arguments[1:-1])]
    return [w[2] for w in parts if len(w) == 5 and w[0] == "redeclare" and w[3] == "=" and w[4] == name]


# combination of several laws


def _join(known: Sources, constraint: str, default: str) -> CombinationRule | None:
    """Return the rule that follows from the connectors and signals of the constraining class and the default class."""
    try:
        chain, there = (known.lineage(*known.find(name)) for name in (constraint, default))
    except InputError:
        return None
    neutral = {" ".join(t.word for t in s.core) for _, cls in there for s in cls.equations}
    own = [(cls, c) for _, cls in chain for c in cls.components()]
    inputs = [c.name for _, c in own if c.prefixes & {"input", "parameter"} and "final" not in c.prefixes]
    outputs = [c.name for _, c in own if "output" in c.prefixes]
    ends = [(c.name, flow) for cls, c in own if (flow := _flow(known, cls, c))]
    shared = [name for name, flow in ends if f"{name} . {flow} = 0" in neutral]
    rest = [name for name, _ in ends if name not in shared]
    signal = next(((u, y) for u in inputs for y in outputs if f"{y} = {u}" in neutral), None)
    if len(rest) not in (0, 2) or len(outputs) > (signal is not None):
        return None
    handed = [name for name in inputs if signal is None or name != signal[0]]
    return CombinationRule(tuple(handed), tuple(shared), (rest[0], rest[1]) if rest else None, signal)


def _flow(known: Sources, cls: ClassText, c: ComponentDeclaration) -> str:
    """Return the name of the flow variable of a connector; empty for any other component."""
    try:
        chain = known.lineage(*known.find(known.resolve(cls, c.type)))
    except InputError:
        return ""
    return next(
        (v.name for _, of in chain if of.kind == "connector" for v in of.components() if "flow" in v.prefixes), ""
    )
