"""The user's Modelica files: which class stands where, and what a name means in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path

from aero_bayes.errors import InputError
from aero_bayes.export.flat import FlatModel, Place
from aero_bayes.export.library import rig_packages
from aero_bayes.physics.classes import ClassText, innermost, read_classes
from aero_bayes.physics.tokens import tokenize


@dataclass(frozen=True)
class SourceFile:
    """One file: its path as the compiler names it, its text and its classes."""

    file: str
    text: str
    classes: tuple[ClassText, ...]

    @property
    def short_name(self) -> str:
        """Full name of what a file without a class that has a body defines, such as a type."""
        if self.classes:
            return ""
        words = [t.word for t in tokenize(self.text)]
        within = "".join(words[1 : words.index(";")]) if words[:1] == ["within"] else ""
        return f"{within}.{Path(self.file).stem}"

    def character(self, byte: int) -> int:
        """Position in characters of a position in bytes."""
        return len(self.text.encode()[:byte].decode(errors="ignore"))


@dataclass(frozen=True)
class Sources:
    """All files of a model."""

    files: Mapping[str, SourceFile]

    def find(self, model: str) -> tuple[SourceFile, ClassText]:
        """The class of that full name. Raises InputError where there is none with a body of its own."""
        if model not in self.by_name:
            raise InputError(f"{model}: the class was not found in the sources")
        return self.by_name[model]

    @cached_property
    def by_name(self) -> Mapping[str, tuple[SourceFile, ClassText]]:
        """All classes with a body, by their full names."""
        every = [(file, cls) for file in self.files.values() for top in file.classes for cls in top.walk()]
        return {cls.full_name: (file, cls) for file, cls in reversed(every)}

    def at(self, place: Place) -> tuple[SourceFile, ClassText, int]:
        """File, class and position in characters of a place."""
        file = self.files.get(place.file)
        if file is None:
            raise InputError(f"{place}: the file is not among the sources")
        position = file.character(place.start)
        cls = innermost(file.classes, position)
        if cls is None:
            raise InputError(f"{place}: no class was found there")
        return file, cls, position

    def resolve(self, cls: ClassText, name: str) -> str:
        """Full name of a class by the name that another class uses."""
        first, dot, rest = name.removeprefix(".").partition(".")
        if first in cls.class_names:
            return f"{cls.full_name}.{name}"
        known = _imported(cls)
        if first in known:
            return known[first] + dot + rest
        for package in _opened_packages(cls):
            if f"{package}.{name}" in self.by_name:
                return f"{package}.{name}"
        return self.meanings(cls).get(first, first) + dot + rest

    def meanings(self, cls: ClassText) -> dict[str, str]:
        """Full names of what the packages around a class define or import, by the names used inside it."""
        every = [cls for _, cls in self.by_name.values()]
        found: dict[str, str] = {}
        around = cls.within
        while around:
            for _, package in (self.by_name[around],) if around in self.by_name else ():
                for name in (*package.class_names, *(c.name for c in package.components())):
                    found.setdefault(name, f"{around}.{name}")
                for alias, target in _imported(package).items():
                    found.setdefault(alias, target)
            for inner in every:
                if inner.within == around:
                    found.setdefault(inner.name, inner.full_name)
            for file in self.files.values():
                if file.short_name.rpartition(".")[0] == around:
                    found.setdefault(file.short_name.rpartition(".")[2], file.short_name)
            around = around.rpartition(".")[0]
        return found


def _imports(cls: ClassText) -> list[list[str]]:
    return [[t.word for t in s.core[1:]] for s in cls.declarations if s.first == "import"]


def _imported(cls: ClassText) -> dict[str, str]:
    """Full names by the names that the imports of a class give them."""
    found: dict[str, str] = {}
    for words in _imports(cls):
        alias = words[0] if words[1:2] == ["="] else words[-1]
        if alias.isidentifier():
            found.setdefault(alias, "".join(words[2:] if words[1:2] == ["="] else words))
    return found


def _opened_packages(cls: ClassText) -> list[str]:
    """Packages all of whose names a class imports: ``import P.*``."""
    return ["".join(words[:-1]) for words in _imports(cls) if words[-1] == ".*"]


def read_sources(sources: Sequence[Path], flat: FlatModel | None = None) -> Sources:
    """Read the files and package folders that a model is exported with; the shipped packages of rigs are among
    them.

    Of libraries, the files that ``flat`` has something from are read as well.

    Raises
    ------
    InputError
        For a file that is missing or is no Modelica; names it.
    """
    files: dict[str, SourceFile] = {}
    for source in (*rig_packages(), *map(Path, sources)):
        if not source.exists():
            raise InputError(f"{source}: no such file")
        for path in files_of(source):
            name = str(path.relative_to(source.parent))
            files[name] = _read(path, name)
    places = [] if flat is None else [v.place for v in flat.variables] + [e.place for e in flat.equations]
    for place in dict.fromkeys(p.file for p in places if p is not None):
        if place not in files and Path(place).is_absolute() and Path(place).is_file():
            files[place] = _read(Path(place), place)
            # what the packages around it import
            for package in (f / "package.mo" for f in Path(place).parents):
                if not package.is_file():
                    break
                if str(package) not in files:
                    files[str(package)] = _read(package, str(package))
    return Sources(files)


def files_of(source: Path) -> list[Path]:
    """A Modelica file itself, or all those in the folder of a package."""
    return sorted(source.rglob("*.mo")) if source.is_dir() else [source]


def _read(path: Path, name: str) -> SourceFile:
    text = path.read_text(encoding="utf-8")
    try:
        return SourceFile(name, text, read_classes(text))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def read_classes_of(source: Path) -> tuple[ClassText, ...]:
    """All classes with a body in a Modelica file or in the folder of a package.

    Raises
    ------
    InputError
        For a file that is no Modelica; names it.
    """
    return tuple(c for path in files_of(source) for top in _read(path, path.name).classes for c in top.walk())


def names_taken(flat: FlatModel, sources: Sequence[Path]) -> set[str]:
    """Names that a new variable of a model must not have: those of its variables and of the loops in its sources."""
    loops = set[str]()
    for source in sources:
        for path in files_of(source):
            words = [t.word for t in tokenize(path.read_text(encoding="utf-8"))]
            loops |= {after for word, after in pairwise(words) if word == "for"}
    return {v.name for v in flat.variables} | loops
