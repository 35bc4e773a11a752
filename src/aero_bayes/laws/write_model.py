"""Models with laws written as Modelica: an extension of the user's class, or a copy of it with edits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from aero_bayes.errors import InputError
from aero_bayes.export.flat import FlatModel
from aero_bayes.files import whole_file
from aero_bayes.language.edits import unified_diff
from aero_bayes.laws.law_writer import with_laws_written
from aero_bayes.laws.model_sources import read_sources
from aero_bayes.laws.placed_law import PlacedLaw
from aero_bayes.laws.redeclare import redeclaring_class, split_by_replaceable


@dataclass(frozen=True)
class WrittenModel:
    """A written model: its name, file and text, and the unified diff from the class of the user.

    To export it, give the sources of the original and ``path``."""

    name: str
    path: Path
    text: str
    diff: str


def write_laws(
    sources: Sequence[Path],
    model: str,
    flat: FlatModel,
    placed_laws: Sequence[PlacedLaw],
    out_dir: Path | str,
    name: str = "",
) -> WrittenModel:
    """Write a model with laws to ``out_dir/<name>.mo``.

    If all laws are at connections, the model extends the class of the user. Otherwise it is a copy of that class, with
    comments and layout kept."""
    inside, others = split_by_replaceable(placed_laws)
    title = name or _name(model, placed_laws)
    base, text, before, old = model, "within ;\n", "", "/dev/null"
    if others or not inside:
        base = _name(model, others) if inside else title
        text, before, old = _edited_source(sources, model, flat, others, base)
    if inside:
        text += "\n".join([*redeclaring_class(base, title, inside), ""])
        before, old = "", "/dev/null"
    path = Path(out_dir) / f"{title}.mo"
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return WrittenModel(title, path, text, unified_diff(before, text, old, path.name))


def can_be_written(sources: Sequence[Path], model: str, flat: FlatModel, placed: PlacedLaw) -> bool:
    """Return whether the source of a model has a place for a law, see :func:`write_laws`."""
    try:
        _edited_source(sources, model, flat, [placed], _name(model, [placed]))
    except InputError:
        return False
    return True


def _name(model: str, placed_laws: Sequence[PlacedLaw]) -> str:
    """Name the written class after the model and its laws."""
    return "_".join([model.rpartition(".")[2], *(placed.instance for placed in placed_laws)])


def _edited_source(
    sources: Sequence[Path], model: str, flat: FlatModel, placed_laws: Sequence[PlacedLaw], title: str
) -> tuple[str, str, str]:
    """Return the text with laws outside of replaceable models, and the text before with its name, for the diff."""
    known = read_sources(sources, flat)
    found = known.find(model)
    target = with_laws_written(known, found, flat, placed_laws, title)
    before, old = ("", "/dev/null") if target.extends else (target.original(), found[0].file)
    return target.written(), before, old
