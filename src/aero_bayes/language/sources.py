"""The user's Modelica files: in which file each class is, and which class a name refers to (Modelica's lookup)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from aero_bayes.errors import InputError
from aero_bayes.language.class_reader import read_classes
from aero_bayes.language.classes import ClassText, innermost
from aero_bayes.language.tokens import SourceLocation, tokenize


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
        """Convert a position in bytes to one in characters."""
        return len(self.text.encode()[:byte].decode(errors="ignore"))


@dataclass(frozen=True)
class Sources:
    """All files of a model."""

    files: Mapping[str, SourceFile]

    def find(self, model: str) -> tuple[SourceFile, ClassText]:
        """Return the class of that full name. Raises InputError where there is none with a body of its own."""
        if model not in self.by_name:
            raise InputError(f"{model}: the class was not found in the sources")
        return self.by_name[model]

    def lineage(self, file: SourceFile, cls: ClassText) -> list[tuple[SourceFile, ClassText]]:
        """Return a class and all that it extends, as far as their sources are there."""
        found = [(file, cls)]
        for base in cls.bases():
            try:
                further = self.lineage(*self.find(self.resolve(cls, base)))
            except InputError:
                continue
            found += [one for one in further if one not in found]
        return found

    @cached_property
    def by_name(self) -> Mapping[str, tuple[SourceFile, ClassText]]:
        """All classes with a body, by their full names."""
        every = [(file, cls) for file in self.files.values() for top in file.classes for cls in top.walk()]
        return {cls.full_name: (file, cls) for file, cls in reversed(every)}

    def at(self, place: SourceLocation) -> tuple[SourceFile, ClassText, int]:
        """Find the file, class and position in characters of a place."""
        file = self.files.get(place.file)
        if file is None:
            raise InputError(f"{place}: the file is not among the sources")
        position = file.character(place.start)
        cls = innermost(file.classes, position)
        if cls is None:
            raise InputError(f"{place}: no class was found there")
        return file, cls, position

    def resolve(self, cls: ClassText, name: str) -> str:
        """Find the full name of a class by the name that another class uses."""
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
        """Return full names of what the packages around a class define or import, by the names used inside it."""
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
    """Return full names by the names that the imports of a class give them."""
    found: dict[str, str] = {}
    for words in _imports(cls):
        alias = words[0] if words[1:2] == ["="] else words[-1]
        if alias.isidentifier():
            found.setdefault(alias, "".join(words[2:] if words[1:2] == ["="] else words))
    return found


def _opened_packages(cls: ClassText) -> list[str]:
    """Return packages all of whose names a class imports: ``import P.*``."""
    return ["".join(words[:-1]) for words in _imports(cls) if words[-1] == ".*"]


def sources_in(files: Iterable[Path]) -> Sources:
    """Read some files by their paths. Raises InputError, with the file, for what is no Modelica."""
    return Sources({str(path): read_file(path, str(path)) for path in files})


def modelica_files(sources: Iterable[Path]) -> Iterator[Path]:
    """Yield the ``.mo`` files of files and package folders, in the order of ``package.order`` where there is one."""
    for source in sources:
        if source.is_file():
            yield source
            continue
        order = source / "package.order"
        names = order.read_text(encoding="utf-8").split() if order.is_file() else []
        inside = [p for p in source.iterdir() if p.suffix == ".mo" or (p / "package.mo").is_file()]
        rank = {n: i for i, n in enumerate(names)}
        inside.sort(key=lambda p: (p.name != "package.mo", rank.get(p.stem, len(rank)), p.name))
        yield from (f for p in inside for f in modelica_files([p]))


def read_modelica_text(path: Path) -> str:
    """Read a Modelica file without a byte-order mark. Raises InputError, with the line, for what is not UTF-8."""
    raw = path.read_bytes()
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise InputError(
            f"{path}:{line}: the byte {raw[error.start]:#04x} is not UTF-8, as Modelica files are: save it as UTF-8"
        ) from None


def read_file(path: Path, name: str) -> SourceFile:
    """Read one file; `name` is its path as the compiler names it."""
    text = read_modelica_text(path)
    try:
        return SourceFile(name, text, read_classes(text))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def read_classes_of(source: Path) -> tuple[ClassText, ...]:
    """Return all classes with a body in a Modelica file or in the folder of a package."""
    return tuple(cls for _, cls in reversed([*sources_in(modelica_files([source])).by_name.values()]))


def main_class(source: Path) -> str:
    """Find the full name of the one model of a source that no other class there uses."""
    if not source.exists():
        raise InputError(f"{source}: no such file")
    found = [c for c in read_classes_of(source) if c.kind in ("model", "block", "class") and not c.partial]
    words = {
        c.full_name: {t.word for s in c.statements for t in s.tokens} | {b.rpartition(".")[2] for b in c.bases()}
        for c in read_classes_of(source)
    }
    roots = [c for c in found if not any(c.name in own for name, own in words.items() if name != c.full_name)]
    if len(roots) == 1:
        return roots[0].full_name
    if not found:
        raise InputError(f"{source}: holds no model")
    names = ", ".join(c.full_name for c in roots or found)
    raise InputError(f"{source}: say which model by name, on the command line with --model: {names}")
