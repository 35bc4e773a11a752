"""Public names of a package whose files are loaded when a name is first used (PEP 562)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module


def lazy_exports(package: str, names: Mapping[str, str]) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """``__getattr__`` and ``__dir__`` of a package that exports names of its files.

    Parameters
    ----------
    package : str
        ``__name__`` of the package.
    names : mapping of str to str
        For each file, without ``.py``, the names that it exports, separated by spaces.

    Returns
    -------
    tuple of callable
    """
    homes = {name: file for file, exported in names.items() for name in exported.split()}

    def load(name: str) -> object:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(f"{package}.{homes[name]}"), name)

    return load, lambda: sorted(homes)
