"""Where Modelica packages are, and how sources and the libraries that they can reach are laid out for a compiler."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path

from aero_bayes.declared import DECLARATION_FILE, DECLARATION_MEMBER, PackageDeclaration, parse_declaration
from aero_bayes.errors import InputError
from aero_bayes.files import user_cache, write_whole
from aero_bayes.modelica.class_reader import read_classes
from aero_bayes.modelica.parse import tokenize, without_comments, words_of
from aero_bayes.modelica.sources import modelica_files, read_modelica_text
from aero_bayes.unknown_names import no_such_file

_OWN = ("~/.openmodelica/libraries", "/usr/lib/omlibrary", "/opt/openmodelica/lib/omlibrary")


def modelica_root() -> Path:
    """Folder of the shipped Modelica packages: installed with this package, or ``modelica/`` of a checkout."""
    package = Path(__file__).resolve().parent.parent
    for folder in (package / "modelica" / "shipped", package.parent.parent / "modelica"):
        if (folder / "Laws" / "package.mo").is_file():
            return folder
    raise InputError("the shipped Modelica packages were not found; reinstall aero-bayes")


@cache
def rig_packages() -> tuple[Path, ...]:
    """Shipped packages of rigs, those that declare something of them; every model is loaded beside them."""
    return tuple(sorted(path.parent for path in modelica_root().glob(f"*/{DECLARATION_FILE}")))


def _declaration_in(folder: Path) -> PackageDeclaration:
    """Return what a package declares of its rigs; nothing where it has no such file."""
    file = folder / DECLARATION_FILE
    return (
        parse_declaration(file.read_text("utf-8"), str(file), folder.name) if file.is_file() else PackageDeclaration()
    )


def declaration_of(model: str, sources: Sequence[Path] = ()) -> PackageDeclaration:
    """Return what the package that a model is from, or is extended from in one of the sources, declares of it.

    Nothing for a model that no declaration names. Raises InputError for a declaration that is not valid."""
    package, _, system = model.partition(".")
    for folder in (*rig_packages(), *sources):
        if folder.name == package and system in (found := _declaration_in(folder)).systems:
            return found
    for file in (s for s in sources if s.is_file()):
        for name in _bases(model, file):
            if (known := declaration_of(name, sources)).systems:
                return known
    return PackageDeclaration()


def _bases(model: str, file: Path) -> list[str]:
    """Return the classes that a model of a file, or a class in it, extends; none where the file cannot be read."""
    with suppress(InputError):
        own = (top for top in read_classes(file.read_text("utf-8", "replace")) if top.full_name == model)
        return [name for top in own for c in top.walk() for name in c.bases() if name != model]
    return []


def declared_members(model: str, sources: Sequence[Path]) -> dict[str, bytes]:
    """Return the declaration that a model's FMU takes along, by the member of the archive."""
    package = declaration_of(model, sources).package
    files = [folder / DECLARATION_FILE for folder in (*rig_packages(), *sources) if folder.name == package]
    return {DECLARATION_MEMBER: files[0].read_bytes()} if files else {}


def copy_sources(folder: Path, sources: Sequence[Path]) -> list[Path]:
    """Copy the shipped packages of rigs and further files into an empty folder, so that nothing beside them is read."""
    loaded = []
    for package in rig_packages():
        shutil.copytree(package, folder / package.name)
        loaded.append(folder / package.name / "package.mo")
    for source in map(Path, sources):
        if not source.exists():
            raise InputError(no_such_file(source))
        for file in modelica_files([source]):
            read_modelica_text(file)  # refused here, under its own path
        target = folder / source.name
        if source.is_dir() and not (source / "package.mo").is_file():
            raise InputError(f"{source}: a Modelica package folder needs a package.mo")
        if not source.is_dir() and (source.suffix != ".mo" or not source.is_file()):
            raise InputError(f"{source}: expected a Modelica file (.mo)")
        if target.exists():
            raise InputError(f"{source}: a {'package' if source.is_dir() else 'file'} of that name is already loaded")
        (shutil.copytree if source.is_dir() else shutil.copyfile)(source, target)
        loaded.append(target / "package.mo" if source.is_dir() else target)
    return loaded


def library_roots(named: Sequence[Path] = ()) -> list[Path]:
    """Folders that may hold packages: those named, those of MODELICAPATH, and OpenModelica's own."""
    for folder in named:
        if not folder.is_dir():
            raise InputError(f"{folder}: no such folder of Modelica packages")
    found = [*named, *(Path(p) for p in os.environ.get("MODELICAPATH", "").split(os.pathsep) if p)]
    home = os.environ.get("OPENMODELICAHOME", "")
    found += [Path(home) / "lib" / "omlibrary"] if home else []
    found += [Path(p).expanduser() for p in _OWN]
    return list(dict.fromkeys(p.resolve() for p in found if p.is_dir()))


def needed_libraries(model: str, files: Iterable[Path], roots: Sequence[Path]) -> dict[str, Path]:
    """Return the packages that the sources mention and ``roots`` hold: name and folder (or file).

    A package folder may carry its version (``Modelica 4.1.0``); of several the latest is taken. The standard
    library comes with the packages that it needs."""
    mentioned = _packages_in(model)
    staged = set()
    shipped = {folder.name for folder in rig_packages()}
    for file in files:
        staged.add(file.parent.name if file.name == "package.mo" else file.stem)
        own = file.parent.rglob("*.mo") if file.name == "package.mo" else [file]
        for path in own if file.parent.name not in shipped else []:
            mentioned |= _packages_in(path.read_text("utf-8", "replace"))
    if "Modelica" in mentioned:
        mentioned |= {"ModelicaServices", "Complex"}
    found = {name: target for name in sorted(mentioned - staged) if (target := _package(name, roots)) is not None}
    if "Modelica" in mentioned - staged and "Modelica" not in found:
        needs = (
            f"{model}: needs the Modelica Standard Library, which was not found; get it from "
            "https://github.com/modelica/ModelicaStandardLibrary and name its folder by"
        )
        ways = "--library, [model] libraries or MODELICAPATH"
        raise InputError(f"{needs} libraries= or MODELICAPATH", f"{needs} {ways}")
    return found


def _packages_in(text: str) -> set[str]:
    """Return names with a capital that a text uses with a dot behind them."""
    words = ["", *words_of(tokenize(text, strict=False)), ""]
    around = zip(words, words[1:], words[2:], strict=False)
    return {word for dot, word, after in around if word[:1].isupper() and after == "." != dot}


def _package(name: str, roots: Sequence[Path]) -> Path | None:
    def version(path: Path) -> list[int]:
        return [int(n) for n in re.findall(r"\d+", path.name.removeprefix(name))]

    for root in roots:
        found = [root / name, *sorted(root.glob(f"{name} [0-9]*"), key=version, reverse=True), root / f"{name}.mo"]
        for option in found:
            if option.is_file() if option.suffix == ".mo" else (option / "package.mo").is_file():
                return option
    return None


def check_model_name(model: str) -> str:
    """Return the name unchanged where it is a dotted Modelica name. Raises InputError otherwise."""
    if not re.fullmatch(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*", model):
        raise InputError(f"{model!r} is not a Modelica model name such as Package.Systems.Rig")
    return model


def identifier(model: str) -> str:
    """Return the model's name as a C identifier, which names the FMU's library."""
    return model.replace(".", "_")


_STANDARD = {"Modelica", "ModelicaServices", "Complex"}
_WORD = re.compile(r"[^\W\d]\w*")
_KIND = r"(?:model|block|class|package|record|connector|type|function)"
_HEAD = re.compile(rf"{_KIND} \w+[^\n]*")
_INSIDE = re.compile(rf"^( *)(?:\w+ )*{_KIND} (\w+)\b.*?^\1end \2;", re.MULTILINE | re.DOTALL)
#: Parts that every view holds, so that most models share one: a compiler keeps what it has read by its folder.
_CORE = frozenset({
    "Blocks", "Math", "Units", "Constants", "Icons", "Utilities", "Electrical/Analog", "Mechanics/Rotational",
    "Mechanics/Translational", "Thermal/HeatTransfer", "Magnetic/FluxTubes",
})  # fmt: skip
# rumoca gives a parameter that is bound to this call the shape of the table itself; a sum is a number to it
_MISREAD = re.compile(r"\bgetTable1DValue\w*\(tableID, \d+, 0\)")


def link_packages(packages: Mapping[str, Path], mentioned: Iterable[str] = ()) -> Path:
    """Return a folder that holds just these packages under their plain names.

    It stays where it is for the same packages, since a compiler may keep what it has read by its path."""
    root = packages.get("Modelica")
    parts: frozenset[str] = frozenset()
    stamp = ""
    if root is not None and root.is_dir():
        stamp = _stamp(root)
        index = _index(root, stamp)
        alone = packages.keys() <= _STANDARD
        parts = (
            _reachable(index, set(mentioned)) if alone else _reachable(index, {w for p in index for w in p.split("/")})
        )
    key = hashlib.sha256(repr((sorted(packages.items()), stamp, sorted(parts))).encode()).hexdigest()[:16]
    folder = user_cache() / "libraries" / key
    if not folder.is_dir():
        folder.parent.mkdir(parents=True, exist_ok=True)
        made = Path(tempfile.mkdtemp(dir=folder.parent))
        for name, target in packages.items():
            if parts and target is root:
                _show(target, made / name, parts)
            else:
                (made / (name if target.is_dir() else f"{name}.mo")).symlink_to(target)
        with contextlib.suppress(OSError):  # another process may have been first
            made.rename(folder)
        shutil.rmtree(made, ignore_errors=True)
    return folder


def path_in_library(file: str) -> str:
    """Path of a library's file from the library's own folder on; that of any other file as it is."""
    folder = user_cache() / "libraries"
    inside = Path(file).parts[len(folder.parts) + 1 :] if Path(file).is_relative_to(folder) else ()
    return "/".join(inside) or file


def names_used_in(files: Iterable[Path]) -> set[str]:
    """Return every name that Modelica files use outside of comments and strings."""
    tokens = (t for f in files for t in tokenize(f.read_text("utf-8", "replace"), strict=False))
    return {t.word for t in tokens if t.kind == "name"}


def _classes(path: str, text: str) -> Iterator[tuple[str, str]]:
    """Yield a class and those that it declares, found by their indentation: path, and text without what is inside."""
    own = _HEAD.search(text)
    head, inside = (text[: own.end()], text[own.end() :]) if own is not None else (text, "")
    for found in _INSIDE.finditer(inside):
        yield from _classes(f"{path}/{found[2]}".strip("/"), found[0])
    yield path, head + _INSIDE.sub(" ", inside)


def _files(root: Path) -> list[str]:
    found = []
    for folder, _, names in os.walk(root):
        found += [os.path.relpath(os.path.join(folder, n), root) for n in names if n.endswith((".mo", ".order"))]
    return sorted(found)


def _stamp(root: Path) -> str:
    state = [(n, (s := (root / n).stat()).st_mtime_ns, s.st_size) for n in _files(root)]
    return hashlib.sha256(repr((str(root), state)).encode()).hexdigest()[:16]


def _part(file: str) -> str:
    """Return the part that a file belongs to: its first two levels, or one where there are no more."""
    levels = file.split("/")[:2]
    if levels[-1] in ("package.mo", "package.order"):
        levels.pop()
    return "/".join(levels).removesuffix(".mo")


def _index(root: Path, stamp: str) -> dict[str, list[str]]:
    """Return, for each class of a library, by its path, the names of others that it mentions."""
    kept = user_cache() / "libraries" / f"{stamp}.json"
    with contextlib.suppress(OSError, ValueError):
        found: dict[str, list[str]] = json.loads(kept.read_text("utf-8"))
        return found
    classes: dict[str, str] = {}
    for file in _files(root):
        if file.endswith(".mo"):
            plain = without_comments((root / file).read_text("utf-8", "replace"))
            classes |= _classes(file.removesuffix(".mo").removesuffix("package").strip("/"), plain)
    names = {level for path in classes for level in path.split("/")}
    index = {path: sorted(names.intersection(_WORD.findall(text))) for path, text in classes.items()}
    with contextlib.suppress(OSError):
        kept.parent.mkdir(parents=True, exist_ok=True)
        write_whole(kept, json.dumps(index))
    return index


def _reachable(index: Mapping[str, Iterable[str]], words: set[str]) -> frozenset[str]:
    """Find the parts of a library that hold a class to which words lead, directly or by other classes."""
    paths = {p: set(p.split("/")) - {""} for p in index}
    found: set[str] = set()
    grown = {p for p in index if paths[p] <= words}
    while grown:
        found |= grown
        words = words.union(*(index[p] for p in grown))
        grown = {p for p in index.keys() - found if paths[p] <= words}
    core = {p for p in index if p.split("/")[0] in _CORE or "/".join(p.split("/")[:2]) in _CORE}
    return frozenset("/".join(p.split("/")[:2]) for p in found | core) | {"", *(p.split("/")[0] for p in found | core)}


def _show(root: Path, view: Path, parts: frozenset[str]) -> None:
    for name in _files(root):
        if _part(name) not in parts:
            continue
        target = view / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if name.startswith("Mechanics/") and _MISREAD.search(text := (root / name).read_text("utf-8", "replace")):
            target.write_text(_MISREAD.sub(lambda m: f"sum({{{m[0]}}})", text), "utf-8")
        else:
            target.symlink_to(root / name)
