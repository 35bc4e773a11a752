"""Replaceable models of a Modelica system: places where its own source lets another class be put in."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from aero_bayes.errors import InputError
from aero_bayes.export.flat import Place
from aero_bayes.physics.classes import ClassText, Component, Statement
from aero_bayes.physics.laws import Law, LawParameter, Shape, is_fitted, noted, parameter_of, snake_case
from aero_bayes.physics.sources import SourceFile, Sources
from aero_bayes.physics.terms import evaluate, parse_term
from aero_bayes.physics.tokens import Token, find_outside, split_outside

#: A law at a replaceable model connects to it by itself; one that learns a curve has it as ``y`` over ``x``, whose
#: largest value in a fit is its parameter ``x_n``.
SHAPE = Shape("replaceable", "y", ("x",), {"x_n": "x"})
_AFTER_TYPE = frozenset({"constrainedby", "annotation"})


@dataclass(frozen=True)
class Join:
    """How several laws are put in one place.

    Of what the partial model has, all are ``handed`` its inputs and parameters, and are connected at the connectors
    that are ``shared``; two connectors are in ``series``, or an input is passed on to an output as a ``signal``.
    """

    handed: tuple[str, ...] = ()
    shared: tuple[str, ...] = ()
    series: tuple[str, str] | None = None
    signal: tuple[str, str] | None = None


@dataclass(frozen=True)
class Replaceable:
    """A replaceable model of a system.

    Parameters
    ----------
    name, description : str
    constraint : str
        Full name of the class that all which fit extend.
    default : str
        Full name of the class that stands there.
    components : tuple of str
        Paths of the components of that class, such as ``thruster_1.rotorEffect``.
    place : Place
    join : Join, optional
        None where the source does not tell how several laws are put there.
    laws : tuple of Law
        Those that fit.
    """

    name: str
    description: str
    constraint: str
    default: str
    components: tuple[str, ...]
    place: Place
    join: Join | None
    laws: tuple[Law, ...] = ()


def replaceables_of(known: Sources, model: str) -> tuple[Replaceable, ...]:
    """The replaceable models that a model, or a class that it extends, declares, and the laws that fit there.

    A law is a class of the sources that extends the constraining one and whose first own parameter with a nominal value
    is zero by default. Places without components or without laws are left out.
    """
    try:
        file, cls = known.find(model)
    except InputError:
        return ()
    chain = _lineage(known, file, cls)
    found: dict[str, Replaceable] = {}
    for of_file, of in chain:
        for statement in of.statements:
            read = _declared(known, of_file, of, statement)
            if read is not None and read.name not in found:
                found[read.name] = replace(read, components=tuple(_components(known, chain, read.name)))
    placed = [one for one in found.values() if one.components]
    with_laws = (replace(one, laws=_laws(known, one.constraint)) for one in placed)
    return tuple(one for one in with_laws if one.laws)


def _lineage(known: Sources, file: SourceFile, cls: ClassText) -> list[tuple[SourceFile, ClassText]]:
    """A class and all that it extends, as far as their sources are there."""
    found = [(file, cls)]
    for base in cls.bases():
        try:
            further = _lineage(known, *known.find(known.resolve(cls, base)))
        except InputError:
            continue
        found += [one for one in further if one not in found]
    return found


def _declared(known: Sources, file: SourceFile, cls: ClassText, s: Statement) -> Replaceable | None:
    """``replaceable model Name = Default constrainedby Partial "description"``, if that is what a statement says."""
    words = [t.word for t in s.tokens]
    kind = next((k for k in ("model", "block") if k in words[:4]), "")
    if s.section != "class" or "replaceable" not in words[:3] or not kind:
        return None
    at = words.index(kind) + 1
    if words[at + 1 : at + 2] != ["="]:
        return None
    default = known.resolve(cls, _dotted(s.tokens[at + 2 :]))
    limit = find_outside(s.tokens, frozenset({"constrainedby"}))
    constraint = known.resolve(cls, _dotted(s.tokens[limit + 1 :])) if limit < len(words) else default
    end = find_outside(s.tokens, frozenset({"annotation"}))
    description = "".join(t.word[1:-1] for t in s.tokens[:end] if t.kind == "text")
    before = file.text[: s.start]
    start, stop = len(before.encode()), len(file.text[: s.end].encode())
    place = Place(file.file, start, stop, before.count("\n") + 1)
    return Replaceable(words[at], description, constraint, default, (), place, _join(known, constraint, default))


def _dotted(tokens: Sequence[Token]) -> str:
    """The name at the beginning."""
    found = ""
    for t in tokens:
        if t.word != "." and (t.kind != "name" or (found and not found.endswith("."))):
            break
        if t.word in _AFTER_TYPE:
            break
        found += t.word
    return found


def _components(known: Sources, chain: Sequence[tuple[SourceFile, ClassText]], name: str) -> Iterator[str]:
    """Paths of the components of a replaceable model, also where it is passed on to a component that has one."""
    for _, cls in reversed(chain):
        for c in cls.components():
            if c.type == name:
                yield c.name
            for inner in _passed(c, name):
                try:
                    deeper = _lineage(known, *known.find(known.resolve(cls, c.type)))
                except InputError:
                    continue
                yield from (f"{c.name}.{path}" for path in _components(known, deeper, inner))


def _passed(c: Component, name: str) -> list[str]:
    """Replaceable models of a component's class in whose place a name is put."""
    parts = [[t.word for t in part] for part in split_outside(c.arguments[1:-1])]
    return [w[2] for w in parts if len(w) == 5 and w[0] == "redeclare" and w[3] == "=" and w[4] == name]


# how several laws go into one place


def _join(known: Sources, constraint: str, default: str) -> Join | None:
    """From the connectors and signals of the partial model, and what the class that stands there does with them."""
    try:
        chain, there = (_lineage(known, *known.find(name)) for name in (constraint, default))
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
    return Join(tuple(handed), tuple(shared), (rest[0], rest[1]) if rest else None, signal)


def _flow(known: Sources, cls: ClassText, c: Component) -> str:
    """Name of the flow variable where a component is a connector; empty where it is none."""
    try:
        chain = _lineage(known, *known.find(known.resolve(cls, c.type)))
    except InputError:
        return ""
    return next(
        (v.name for _, of in chain if of.kind == "connector" for v in of.components() if "flow" in v.prefixes), ""
    )


# the laws


def _laws(known: Sources, constraint: str) -> tuple[Law, ...]:
    """Classes that extend a partial one and have something to fit, in the order of files and classes."""
    found: list[Law] = []
    if constraint not in known.by_name:
        return ()
    base = known.find(constraint)[1]
    shared = {c.full_name for _, c in _lineage(known, *known.find(constraint))}
    for file in (file for file in known.files.values() if not Path(file.file).is_absolute()):
        for cls in (c for top in file.classes for c in top.walk()):
            if cls.partial or cls.kind not in ("model", "block") or cls.full_name in shared:
                continue
            chain = _lineage(known, file, cls)
            if not any(c.full_name == constraint for _, c in chain):
                continue
            own = [c for _, of in chain if of.full_name not in shared for c in of.components()]
            try:
                law = _law(cls, base, own)
            except InputError as error:
                raise InputError(f"{file.file}: {cls.full_name}: {error}") from None
            if law is not None:
                found.append(law)
    return tuple(found)


def _law(cls: ClassText, base: ClassText, own: Sequence[Component]) -> Law | None:
    switches = [c for c in own if is_fitted(c)]
    if not switches or _number(switches[0]) != 0.0:
        return None
    fitted = tuple(parameter_of(c) for c in switches)
    set_from_outside = [c for c in own if "parameter" in c.prefixes and not c.prefixes & {"final", "protected"}]
    others = {c.name: value for c in set_from_outside if not is_fitted(c) and (value := _number(c)) is not None}
    sizes = {name: value for name, value in others.items() if name in SHAPE.sizes}
    widths = {name: value for name, value in others.items() if name not in sizes}
    _check(fitted, sizes)
    notes = [noted(cls.annotation, word) for word in ("refines", "learned", "threshold", "vanishing")]
    if notes[1] not in ("", "x"):
        raise InputError(f'learned = {notes[1]!r}; expected "x", the variable over which y is learned')
    refines, learned, threshold, vanishing = notes
    return Law(
        snake_case(cls.name), "replaceable", cls.full_name, cls.description, fitted, sizes, frozenset(), {}, "",
        refines, learned, threshold, vanishing, SHAPE, "", cls, base, "", widths,
    )  # fmt: skip


def _number(c: Component) -> float | None:
    try:
        return evaluate(parse_term(c.binding), {}) if c.binding else None
    except InputError:
        return None


def _check(fitted: Sequence[LawParameter], sizes: Mapping[str, float]) -> None:
    """Raise InputError for an attribute that is no number."""
    for p in fitted:
        for term in (p.default, p.minimum, p.maximum, p.nominal):
            if term is not None:
                evaluate(term, sizes)
