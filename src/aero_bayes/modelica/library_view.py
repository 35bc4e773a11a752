"""Folders of libraries for the compiler: of the standard library only what a model can reach."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from aero_bayes.files import user_cache, write_whole
from aero_bayes.modelica.tokens import tokenize, without_comments

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
