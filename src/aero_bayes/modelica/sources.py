"""A class with the declarations and equations of its base classes inlined, so that a copy of them can be edited."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from aero_bayes.errors import InputError
from aero_bayes.modelica.class_reader import read_classes
from aero_bayes.modelica.classes import ClassText, ComponentDeclaration, SourceStatement, dotted_name, innermost
from aero_bayes.modelica.edits import TextEdit, add_equations, apply_edits, replace_names
from aero_bayes.modelica.parse import (
    SourceLocation,
    Token,
    find_outside,
    one_line,
    skip_group,
    split_outside,
    tokenize,
)
from aero_bayes.unknown_names import no_such_file


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
        for words in _imports(cls):  # of ``import P.*`` the last word is ``.*``
            if words[-1] == ".*" and (there := "".join(words[:-1]) + f".{name}") in self.by_name:
                return there
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


def sources_in(files: Iterable[Path]) -> Sources:
    """Read some files by their paths. Raises InputError, with the file, for what is no Modelica."""
    return Sources({str(path): read_file(path, str(path)) for path in files})


def as_packages(sources: Iterable[Path]) -> tuple[Path, ...]:
    """Return sources with the folder of a whole library in place of a ``package.mo`` of it, as editors name it."""
    return tuple(dict.fromkeys(_library_of(s) if s.name == "package.mo" and s.is_file() else s for s in sources))


def _library_of(file: Path) -> Path:
    """Return the outermost folder of a library; the file where that is not called as the package in it."""
    found, folder = file, file.parent
    while folder != found and (folder / file.name).is_file():
        if not re.search(rf"\bpackage\s+{re.escape(folder.absolute().name)}\b", read_modelica_text(folder / file.name)):
            break
        found, folder = folder, folder.parent
    return found


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


def main_class(source: Path) -> str:
    """Find the full name of the one model of a source that no other class there uses."""
    if not source.exists():
        raise InputError(no_such_file(source))
    classes = [cls for _, cls in reversed([*sources_in(modelica_files([source])).by_name.values()])]
    found = [c for c in classes if c.kind in ("model", "block", "class") and not c.partial]
    words = {
        c.full_name: {t.word for s in c.statements for t in s.tokens} | {b.rpartition(".")[2] for b in c.bases()}
        for c in classes
    }
    roots = [c for c in found if not any(c.name in own for name, own in words.items() if name != c.full_name)]
    if len(roots) == 1:
        return roots[0].full_name
    if not found:
        raise InputError(f"{source}: holds no model")
    names = ", ".join(c.full_name for c in roots or found)
    what = f"{source}: say which model by"
    raise InputError(f"{what} its name, with the file as sources=: {names}", f"{what} --model: {names}")


def inline_base_classes(known: Sources, file: SourceFile, cls: ClassText) -> tuple[SourceFile, ClassText]:
    """Write a file of ``cls`` alone, with declarations and equations of base classes in place of ``extends``.

    Names that mean something in the packages around a class are given in full."""
    text = standalone_text(known, file, cls)
    (own,) = read_classes(text)
    for clause in [s for s in own.declarations if s.first == "extends"]:
        (own,) = read_classes(text)
        name, arguments = _clause(clause)
        base_file, base = known.find(known.resolve(cls, name))
        inner_file, inner = inline_base_classes(known, base_file, base)
        if inner.classes:
            raise InputError(f"{base.full_name}: a base class with classes of its own cannot be written out")
        current = next(s for s in own.declarations if s.first == "extends")
        declared = _declarations(inner_file.text, inner, arguments)
        edits = [TextEdit(current.start, current.end, "\n  ".join(declared))]
        stated = _whole(inner)
        lines = {k: [one_line(inner_file.text[s.start : s.end]) for s in v] for k, v in stated.items()}
        edits += add_equations(text, own, lines["equation"])
        if lines["initial equation"]:
            at = own.annotation_start if own.annotation_start >= 0 else own.close
            edits.append(
                TextEdit(at, at, "\n".join(["initial equation", *(f"  {k}" for k in lines["initial equation"]), ""]))
            )
        text = apply_edits(text, edits)
    (own,) = read_classes(text)
    own.within = ""
    return SourceFile(file.file, text, (own,)), own


def standalone_text(known: Sources, file: SourceFile, cls: ClassText) -> str:
    """Return the text of a class outside its package, moved to the margin, with names that still mean the same."""
    own = {c.name for c in cls.components()} | set(cls.class_names)
    meanings = {k: v for k, v in known.meanings(cls).items() if k not in own}
    begin = file.text.rfind("\n", 0, cls.start) + 1
    margin = file.text[begin : cls.start] if not file.text[begin : cls.start].strip() else ""
    changed: list[TextEdit] = []
    for inner in cls.walk():
        local = {c.name for c in inner.components()} | set(inner.class_names)
        outer = {k: v for k, v in meanings.items() if k not in local}
        for s in inner.statements:
            names = {c.name_token.start for c in inner.declared_in(s)}
            changed += [e for e in replace_names(s.tokens, outer.get) if e.start not in names]
    body = apply_edits(file.text[begin : cls.end], [e.moved(-begin) for e in changed])
    return re.sub(rf"^{margin}", "", body, flags=re.MULTILINE) + "\n" if margin else body + "\n"


def _clause(clause: SourceStatement) -> tuple[str, Sequence[Token]]:
    """Return the name and the modifiers of an extends clause."""
    at = find_outside(clause.core, frozenset({"("}), 1)
    name = "".join(t.word for t in clause.core[1:at])
    return name, clause.core[at + 1 : skip_group(clause.core, at) - 1] if at < len(clause.core) else ()


def _whole(cls: ClassText) -> dict[str, list[SourceStatement]]:
    """Return equations by their section."""
    if any(s.inside or s.section.endswith("algorithm") for s in cls.statements):
        raise InputError(f"{cls.name}: a base class with branches or algorithms cannot be written out")
    return {name: [s for s in cls.statements if s.section == name] for name in ("equation", "initial equation")}


def _declarations(text: str, cls: ClassText, arguments: Sequence[Token]) -> list[str]:
    """Return the declarations of a base class with the modifiers of the clause that extends it."""
    modifiers: dict[str, Sequence[Token]] = {}
    redeclared: dict[str, str] = {}
    for part in split_outside(arguments):
        while part[0].word in ("each", "final"):
            part = part[1:]
        if [t.word for t in part[:2]] == ["redeclare", "model"] and part[3].word == "=":
            redeclared[part[2].word] = _words(part[4:])
            continue
        if part[0].word in ("redeclare", "replaceable") or part[0].kind != "name":
            raise InputError(f"{cls.name}: the modifier {part[0].word!r} of a base class cannot be written out")
        modifiers[part[0].word] = part[1:]
    # short class definitions, such as replaceable models
    lines = [_redeclared(text, s, redeclared) for s in cls.statements if s.section == "class"]
    section = "public"
    for s in cls.declarations:
        if s.section != section:
            lines.append(s.section)
            section = s.section
        edits = [e for c in cls.declared_in(s) for e in _modified(c, modifiers.pop(c.name, ()))]
        lines.append(apply_edits(text[s.start : s.end], [e.moved(-s.start) for e in edits]))
    if modifiers:
        raise InputError(f"{cls.name}: the modifier of {next(iter(modifiers))!r} cannot be written out")
    return lines if section == "public" else [*lines, "public"]


def _redeclared(text: str, s: SourceStatement, classes: Mapping[str, str]) -> str:
    """Return a short class definition with the class that a redeclaration gives it."""
    at = find_outside(s.tokens, frozenset({"="}))
    given = classes.get(s.tokens[at - 1].word) if at < len(s.tokens) else None
    if given is None:
        return text[s.start : s.end]
    after = at + 1 + dotted_name(s.tokens[at + 1 :])[1]
    return f"{text[s.start : s.tokens[at].end]} {given}{text[s.tokens[after - 1].end : s.end]}"


def _modified(c: ComponentDeclaration, modifier: Sequence[Token]) -> list[TextEdit]:
    """Return edits of a declaration by what follows its name in a modifier: ``(start = 1) = 2``."""
    edits: list[TextEdit] = []
    at = 0
    after = (c.arguments[-1] if c.arguments else c.name_token).end
    if modifier and modifier[0].word == "(":
        at = skip_group(modifier, 0)
        inner = {p[0].word: _words(p) for p in split_outside(modifier[1 : at - 1])}
        old = {p[0].word: _words(p) for p in split_outside(c.arguments[1:-1])}
        text = f"({', '.join({**old, **inner}.values())})"
        start = c.arguments[0].start if c.arguments else after
        edits.append(TextEdit(start, after, text))
    if at < len(modifier) and modifier[at].word == "=":
        value = _words(modifier[at + 1 :])
        if c.binding:
            edits.append(TextEdit(c.binding[0].start, c.binding[-1].end, value))
        elif edits:
            edits = [TextEdit(edits[0].start, edits[0].end, f"{edits[0].text} = {value}")]
        else:
            edits.append(TextEdit(after, after, f" = {value}"))
    return edits


def _words(tokens: Sequence[Token]) -> str:
    return " ".join(t.word for t in tokens).replace(" . ", ".").replace(" (", "(").replace("( ", "(").replace(" )", ")")
