"""Many rigs of one model, on whatever workers the user brings."""

from __future__ import annotations

from typing import TYPE_CHECKING

from aero_bayes.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from aero_bayes.fleet.executors import open_executor as open_executor
    from aero_bayes.fleet.parcels import Parcel as Parcel
    from aero_bayes.fleet.population import fit_population as fit_population
    from aero_bayes.fleet.population import stand_out as stand_out
    from aero_bayes.fleet.prevalence import NamedEffect as NamedEffect
    from aero_bayes.fleet.prevalence import estimate_prevalence as estimate_prevalence
    from aero_bayes.fleet.prevalence import shared_out as shared_out
    from aero_bayes.fleet.rigs import FleetFile as FleetFile
    from aero_bayes.fleet.rigs import FleetPlan as FleetPlan
    from aero_bayes.fleet.rigs import Rig as Rig
    from aero_bayes.fleet.rigs import read_fleet as read_fleet
    from aero_bayes.fleet.runner import Task as Task
    from aero_bayes.fleet.runner import run_tasks as run_tasks
    from aero_bayes.fleet.summary import summarise_fleet as summarise_fleet
    from aero_bayes.fleet.table import Row as Row
    from aero_bayes.fleet.table import Table as Table
    from aero_bayes.fleet.task import RigTask as RigTask
    from aero_bayes.fleet.task import attempt as attempt
    from aero_bayes.fleet.whole import fleet as fleet
    from aero_bayes.fleet.whole import tasks_of as tasks_of

__getattr__, __dir__ = lazy_exports(
    __name__,
    {
        "executors": "open_executor",
        "parcels": "Parcel",
        "population": "fit_population stand_out",
        "prevalence": "NamedEffect estimate_prevalence shared_out",
        "rigs": "FleetFile FleetPlan Rig read_fleet",
        "runner": "Task run_tasks",
        "summary": "summarise_fleet",
        "table": "Row Table",
        "task": "RigTask attempt",
        "whole": "fleet tasks_of",
    },
)
