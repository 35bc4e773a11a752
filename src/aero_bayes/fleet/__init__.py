"""Many rigs of one model, on whatever workers the user brings."""

from aero_bayes.fleet.executors import open_executor
from aero_bayes.fleet.population import fit_population, stand_out
from aero_bayes.fleet.prevalence import NamedEffect, estimate_prevalence, shared_out
from aero_bayes.fleet.rigs import FleetFile, FleetPlan, Rig, read_fleet
from aero_bayes.fleet.runner import Task, run_tasks
from aero_bayes.fleet.summary import summarise_fleet
from aero_bayes.fleet.table import Row, Table
from aero_bayes.fleet.task import RigTask, attempt
from aero_bayes.fleet.whole import fleet, tasks_of

__all__ = [
    "FleetFile", "FleetPlan", "NamedEffect", "Rig", "RigTask", "Row", "Table", "Task", "attempt", "estimate_prevalence",
    "fit_population", "fleet", "open_executor", "read_fleet", "run_tasks", "shared_out", "stand_out", "summarise_fleet",
    "tasks_of",
]  # fmt: skip
