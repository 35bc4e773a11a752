"""Many rigs of one model, on whatever workers the user brings."""

from __future__ import annotations

from typing import TYPE_CHECKING

from aero_bayes.lazy import importing

if TYPE_CHECKING:
    from aero_bayes.fleet.executors import open_executor
    from aero_bayes.fleet.parcels import Parcel
    from aero_bayes.fleet.population import fit_population, stand_out
    from aero_bayes.fleet.prevalence import NamedEffect, estimate_prevalence, shared_out
    from aero_bayes.fleet.rigs import FleetFile, FleetPlan, Rig, read_fleet
    from aero_bayes.fleet.runner import Task, run_tasks
    from aero_bayes.fleet.summary import summarise_fleet
    from aero_bayes.fleet.table import Row, Table
    from aero_bayes.fleet.task import RigTask, attempt
    from aero_bayes.fleet.whole import fleet, tasks_of

#: Where each name lives; imported when first used, so that a worker that only runs tasks need not load what fits.
_HOME = {
    "FleetFile": "rigs",
    "FleetPlan": "rigs",
    "NamedEffect": "prevalence",
    "Parcel": "parcels",
    "Rig": "rigs",
    "RigTask": "task",
    "Row": "table",
    "Table": "table",
    "Task": "runner",
    "attempt": "task",
    "estimate_prevalence": "prevalence",
    "fit_population": "population",
    "fleet": "whole",
    "open_executor": "executors",
    "read_fleet": "rigs",
    "run_tasks": "runner",
    "shared_out": "prevalence",
    "stand_out": "population",
    "summarise_fleet": "summary",
    "tasks_of": "whole",
}

__all__ = [
    "FleetFile",
    "FleetPlan",
    "NamedEffect",
    "Parcel",
    "Rig",
    "RigTask",
    "Row",
    "Table",
    "Task",
    "attempt",
    "estimate_prevalence",
    "fit_population",
    "fleet",
    "open_executor",
    "read_fleet",
    "run_tasks",
    "shared_out",
    "stand_out",
    "summarise_fleet",
    "tasks_of",
]

__getattr__ = importing(__name__, _HOME)
