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
from aero_bayes.scratch import ScratchFolder


@dataclass(frozen=True)
class WrittenModel:
    """A written model: its name, file and text, and the unified diff from the class of the user.

    To export it, give the sources of the original and ``path``.
    """

    name: str
    path: Path
    text: str
    diff: str


def write_law(
    sources: Sequence[Path],
    model: str,
    flat: FlatModel,
    placed_laws: Sequence[PlacedLaw],
    out_dir: Path | str,
    name: str = "",
) -> WrittenModel:
    """Write a model with laws to ``out_dir/<name>.mo``.

    If all laws are at connections, the model extends the class of the user. Otherwise it is a copy of that class, with
    comments and layout kept. A library is never edited.

    Parameters
    ----------
    sources : sequence of Path
        The files and package folders that the model was loaded from.
    model : str
        Its full name.
    flat : FlatModel
        The model without the laws, in which the ports were found.
    placed_laws : sequence of PlacedLaw
        In the order in which :func:`~aero_bayes.laws.compose.compose_laws` gets them.
    name : str, optional
        Name of the written class; by default the name of the model and those of the laws.

    Raises
    ------
    InputError
        Where the source has no place for a law, although the flat model has one.
    """
    known = read_sources(sources, flat)
    file, cls = known.find(model)
    title = name or "_".join([cls.name, *(u.instance for u in placed_laws)])
    target = with_laws_written(known, (file, cls), flat, placed_laws, title)
    text = target.written()
    path = Path(out_dir) / f"{title}.mo"
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    before, old = ("", "/dev/null") if target.extends else (target.original(), file.file)
    return WrittenModel(title, path, text, unified_diff(before, text, old, path.name))


def can_be_written(sources: Sequence[Path], model: str, flat: FlatModel, placed: PlacedLaw) -> bool:
    """Return whether the source of a model has a place for a law, see :func:`write_law`."""
    try:
        with ScratchFolder() as folder:
            write_law(sources, model, flat, [placed], folder)
    except InputError:
        return False
    return True


def write_laws(
    sources: Sequence[Path],
    model: str,
    flat: FlatModel,
    placed_laws: Sequence[PlacedLaw],
    out_dir: Path | str,
    name: str = "",
) -> WrittenModel:
    """Write laws as :func:`write_law` does, also those in replaceable models as well.

    The model then extends the class of the user, or the class with the other laws, which comes first in the file.
    """
    inside, others = split_by_replaceable(placed_laws)
    if not inside:
        return write_law(sources, model, flat, others, out_dir, name)
    title = name or "_".join([model.rpartition(".")[2], *(u.instance for u in placed_laws)])
    before, base = "within ;\n", model
    if others:
        with ScratchFolder() as folder:
            first = write_law(sources, model, flat, others, folder)
        before, base = first.text, first.name
    text = before + "\n".join([*redeclaring_class(base, title, inside), ""])
    path = Path(out_dir) / f"{title}.mo"
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return WrittenModel(title, path, text, unified_diff("", text, "/dev/null", path.name))
