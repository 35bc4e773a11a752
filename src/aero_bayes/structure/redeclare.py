"""Laws in place of replaceable models: a class that extends the user's class and redeclares these."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from aero_bayes.errors import CannotFinishError
from aero_bayes.files import ScratchFolder
from aero_bayes.modelica.flat import FlatModel
from aero_bayes.modelica.rumoca_front import load_flat
from aero_bayes.structure.balance import CombinationRule, ReplaceableModel
from aero_bayes.structure.candidates import PlacedLaw, in_sentence


def split_by_replaceable(placed_laws: Iterable[PlacedLaw]) -> tuple[list[PlacedLaw], list[PlacedLaw]]:
    """Return the laws in replaceable models, and the others."""
    every = list(placed_laws)
    return [u for u in every if u.port.replaceable is not None], [u for u in every if u.port.replaceable is None]


def load_with_redeclarations(
    base: str, name: str, placed_laws: Sequence[PlacedLaw], sources: Sequence[Path], libraries: Sequence[Path]
) -> FlatModel:
    """Return the flat model of ``base`` with laws in its replaceable models."""
    with ScratchFolder() as folder:
        path = Path(folder) / f"{name}.mo"
        path.write_text("\n".join(["within ;", *redeclaring_class(base, name, placed_laws), ""]), encoding="utf-8")
        return load_flat(name, (*sources, path), libraries)


def redeclaring_class(base: str, name: str, placed_laws: Sequence[PlacedLaw]) -> list[str]:
    """Return the lines of a model ``name`` that extends ``base`` and redeclares its replaceable models.

    Modifiers stand at the components (``bodyEffect(tau_c = tau_c)``) and not in the redeclaration, where rumoca drops
    them."""
    here: dict[str, list[PlacedLaw]] = {}
    for placed in placed_laws:
        here.setdefault(_place(placed).name, []).append(placed)
    redeclared: list[str] = []
    modified: dict[str, list[str]] = {}
    classes: list[str] = []
    for name_there, own in here.items():
        place, alone = _place(own[0]), len(own) == 1
        class_name = own[0].law.model if alone else f"{name_there}s"
        redeclared.append(f"redeclare model {name_there} = {class_name}")
        if not alone:
            classes += _together(place, class_name, own)
        inner = _modifiers(own[0]) if alone else [f"{u.instance}({', '.join(_modifiers(u))})" for u in own]
        for path in place.components:
            owner, _, component = path.rpartition(".")
            modified.setdefault(owner, []).append(f"{component}({', '.join(inner)})")
    arguments = redeclared + modified.pop("", [])
    arguments += [_nested(owner.split("."), items) for owner, items in modified.items()]
    what = " and ".join(dict.fromkeys(in_sentence(placed.law.description) for placed in placed_laws))
    about = f"{base.rpartition('.')[2]} with {what if len(what) <= 100 else 'several effects'}"
    return [
        f'model {name} "{about}"',
        f"  extends {base}(", ",\n".join(f"    {a}" for a in arguments) + ");",
        *(f"  {line}" for placed in placed_laws for line in placed.declarations()),
        *(f"  {line}" for line in classes),
        f'  annotation (Documentation(info = "<html><p>{base.rpartition(".")[2]} with {what}.</p></html>"));',
        f"end {name};",
    ]  # fmt: skip


def component_path(placed: PlacedLaw, placed_laws: Sequence[PlacedLaw]) -> str:
    """Return the path of the component of a law in the redeclaring class; the first if there are several."""
    place = _place(placed)
    alone = sum(_place(other).name == place.name for other in placed_laws) == 1
    return place.components[0] if alone else f"{place.components[0]}.{placed.instance}"


def _place(placed: PlacedLaw) -> ReplaceableModel:
    assert placed.port.replaceable is not None
    return placed.port.replaceable


def _modifiers(placed: PlacedLaw) -> list[str]:
    given = [f"{p.name} = {placed.names[p.name]}" for p in placed.parameters()]
    return given + [f"{size} = {value!r}" for size, value in placed.all_nominals.items()]


def _nested(path: Sequence[str], items: Iterable[str]) -> str:
    inner = f"{path[-1]}({', '.join(items)})"
    for owner in reversed(path[:-1]):
        inner = f"{owner}({inner})"
    return inner


def _together(place: ReplaceableModel, name: str, placed_laws: Sequence[PlacedLaw]) -> list[str]:
    """Return a local model with several laws: in series if a flow or a signal passes through, else in parallel."""
    join = place.combination
    if join is None:
        raise CannotFinishError(
            f"{place.place}: {place.default} does not tell how several laws go in the place of {place.name}"
        )
    components, previous = [], join.signal[0] if join.signal else ""
    for u in placed_laws:
        passed = [f"{join.signal[0]} = {previous}"] if join.signal else []
        handed = [f"{n} = {n}" for n in join.handed]
        components.append(f"  {u.law.model} {u.instance}({', '.join([*passed, *handed])});")
        previous = f"{u.instance}.{join.signal[1]}" if join.signal else ""
    return [
        f'model {name} "Several laws in one place"',
        f"  extends {place.constraint};",
        *components,
        "equation",
        *(f"  {line}" for line in _joined(join, [u.instance for u in placed_laws], previous)),
        f"end {name};",
    ]


def _joined(join: CombinationRule, names: Sequence[str], last: str) -> list[str]:
    lines = [f"{join.signal[1]} = {last};"] if join.signal else []
    if join.series:
        first, end = join.series
        ends = [first, *(f"{n}.{side}" for n in names for side in (first, end)), end]
        lines += [f"connect({a}, {b});" for a, b in zip(ends[::2], ends[1::2], strict=True)]
    return lines + [f"connect({c}, {n}.{c});" for c in join.shared for n in names]
