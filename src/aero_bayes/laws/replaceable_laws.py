"""Laws for replaceable models: classes in the sources that can take their place and are off at their defaults."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from aero_bayes.errors import InputError
from aero_bayes.language.classes import ClassText, ComponentDeclaration, snake_case
from aero_bayes.language.parse import parse_expression
from aero_bayes.language.sources import Sources
from aero_bayes.language.values import evaluate_expression
from aero_bayes.laws.law import Law, LawInterface, LawParameter, annotation_text, is_fitted_parameter, law_parameter

#: A law in place of a replaceable model brings its own connections. A learned curve is ``y`` over ``x``, and its
#: parameter ``x_n`` is the largest value of ``x`` in a fit.
REPLACEABLE_INTERFACE = LawInterface("replaceable", "y", ("x",), {"x_n": "x"})


def laws_for_constraint(known: Sources, constraint: str) -> tuple[Law, ...]:
    """Return the laws for replaceable models with a constraining class, in the order of files and classes.

    A law is a class that extends the constraining class, and whose first own parameter with a nominal value is zero by
    default."""
    found: list[Law] = []
    if constraint not in known.by_name:
        return ()
    shared = {c.full_name for _, c in known.lineage(*known.find(constraint))}
    for file in (file for file in known.files.values() if not Path(file.file).is_absolute()):
        for cls in (c for top in file.classes for c in top.walk()):
            if cls.partial or cls.kind not in ("model", "block") or cls.full_name in shared:
                continue
            chain = known.lineage(file, cls)
            if not any(c.full_name == constraint for _, c in chain):
                continue
            own = [c for _, of in chain if of.full_name not in shared for c in of.components()]
            try:
                law = _law(cls, constraint, own)
            except InputError as error:
                raise InputError(f"{file.file}: {cls.full_name}: {error}") from None
            if law is not None:
                found.append(law)
    return tuple(found)


def _law(cls: ClassText, constraint: str, own: Sequence[ComponentDeclaration]) -> Law | None:
    switches = [c for c in own if is_fitted_parameter(c)]
    if not switches or _number(switches[0]) != 0.0:
        return None
    fitted = tuple(law_parameter(c) for c in switches)
    set_from_outside = [c for c in own if "parameter" in c.prefixes and not c.prefixes & {"final", "protected"}]
    others = {
        c.name: value for c in set_from_outside if not is_fitted_parameter(c) and (value := _number(c)) is not None
    }
    nominals = {name: value for name, value in others.items() if name in REPLACEABLE_INTERFACE.nominals}
    widths = {name: value for name, value in others.items() if name not in nominals}
    _check(fitted, nominals)
    notes = [annotation_text(cls.annotation, word) for word in ("refines", "learned", "threshold")]
    if notes[1] not in ("", "x"):
        raise InputError(f'learned = {notes[1]!r}; expected "x", the variable over which y is learned')
    refines, learned, threshold = notes
    return Law(
        snake_case(cls.name), "replaceable", cls.full_name, cls.description, fitted, nominals, frozenset(), {}, "",
        refines, learned, threshold, REPLACEABLE_INTERFACE, "", cls, widths, constraint,
    )  # fmt: skip


def _number(c: ComponentDeclaration) -> float | None:
    try:
        return evaluate_expression(parse_expression(c.binding), {}) if c.binding else None
    except InputError:
        return None


def _check(fitted: Sequence[LawParameter], nominals: Mapping[str, float]) -> None:
    """Raise InputError for an attribute that is no expression in nominal values."""
    for p in fitted:
        for term in (p.default, p.minimum, p.maximum, p.nominal):
            if term is not None:
                evaluate_expression(term, nominals)
