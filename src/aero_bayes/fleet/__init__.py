"""Many rigs of one model, on whatever workers the user brings."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from aero_bayes.fleet.executors import open_executor
    from aero_bayes.fleet.rigs import Rig, read_fleet
    from aero_bayes.fleet.runner import run_tasks
    from aero_bayes.fleet.table import Row, Table
    from aero_bayes.fleet.whole import fleet

#: Where each name lives; imported when first used, so that a worker that only runs tasks need not load what fits.
_HOME = {
    "Rig": "rigs", "Row": "table", "Table": "table", "fleet": "whole", "open_executor": "executors",
    "read_fleet": "rigs", "run_tasks": "runner",
}  # fmt: skip

__all__ = ["Rig", "Row", "Table", "fleet", "open_executor", "read_fleet", "run_tasks"]


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
