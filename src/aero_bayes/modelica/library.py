"""Where Modelica packages are, and how a model's sources are laid out for a compiler."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterable, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path

from aero_bayes.declared import DECLARATION_FILE, DECLARATION_MEMBER, PackageDeclaration, parse_declaration
from aero_bayes.errors import InputError
from aero_bayes.modelica.class_reader import read_classes
from aero_bayes.modelica.sources import modelica_files, read_modelica_text
from aero_bayes.modelica.tokens import tokenize, words_of
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
        if source.is_dir():
            if not (source / "package.mo").is_file():
                raise InputError(f"{source}: a Modelica package folder needs a package.mo")
            target = folder / source.name
            if target.exists():
                raise InputError(f"{source}: a package of that name is already loaded")
            shutil.copytree(source, target)
            loaded.append(target / "package.mo")
        else:
            if source.suffix != ".mo" or not source.is_file():
                raise InputError(f"{source}: expected a Modelica file (.mo)")
            target = folder / source.name
            if target.exists():
                raise InputError(f"{source}: a file of that name is already loaded")
            shutil.copyfile(source, target)
            loaded.append(target)
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
        raise InputError(
            f"{model}: needs the Modelica Standard Library, which was not found; get it from "
            "https://github.com/modelica/ModelicaStandardLibrary and name its folder by --library, "
            "[model] libraries or MODELICAPATH"
        )
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
