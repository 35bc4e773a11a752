"""The files that a model was made from, and the names in them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from aero_bayes.errors import InputError
from aero_bayes.export.flat import FlatModel
from aero_bayes.export.library import rig_packages
from aero_bayes.language.sources import SourceFile, Sources, modelica_files, read_file, read_modelica_text
from aero_bayes.language.tokens import tokenize, words_of


def read_sources(sources: Sequence[Path], flat: FlatModel | None = None) -> Sources:
    """Read the files and package folders of a model, and the shipped packages of rigs.

    Of libraries, only the files are read that declare something in ``flat``, and the packages around these."""
    files: dict[str, SourceFile] = {}
    for source in (*rig_packages(), *map(Path, sources)):
        if not source.exists():
            raise InputError(f"{source}: no such file")
        for path in modelica_files([source]):
            name = str(path.relative_to(source.parent))
            files[name] = read_file(path, name)
    places = [] if flat is None else [v.place for v in flat.variables] + [e.place for e in flat.equations]
    for place in dict.fromkeys(p.file for p in places if p is not None):
        if place not in files and Path(place).is_absolute() and Path(place).is_file():
            files[place] = read_file(Path(place), place)
            # the packages around it may import names
            for package in (f / "package.mo" for f in Path(place).parents):
                if not package.is_file():
                    break
                if str(package) not in files:
                    files[str(package)] = read_file(package, str(package))
    return Sources(files)


def reserved_names(flat: FlatModel, sources: Sequence[Path]) -> set[str]:
    """Return names that a new variable must not have.

    Those of variables of the model, and of loop indices in its sources."""
    loops = set[str]()
    for path in modelica_files(sources):
        words = words_of(tokenize(read_modelica_text(path)))
        loops |= {after for word, after in pairwise(words) if word == "for"}
    return {v.name for v in flat.variables} | loops
