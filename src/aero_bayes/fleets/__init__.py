"""Many rigs of one model, on whatever workers the user brings.

What fits and summarises is imported from its files (``whole``, ``task``, ``summary``, ``population``):
a worker that runs other tasks starts without it.
"""

from aero_bayes.fleets.executors import open_executor
from aero_bayes.fleets.rigs import FleetFile, FleetPlan, Rig, read_fleet
from aero_bayes.fleets.runner import Task, run_tasks
from aero_bayes.fleets.table import Row, Table

__all__ = [
    "FleetFile", "FleetPlan", "Rig", "Row", "Table", "Task", "open_executor", "read_fleet", "run_tasks",
]  # fmt: skip
