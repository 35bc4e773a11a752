"""Many rigs of one model, on whatever workers the user brings.

What fits and summarises is imported from its files (``whole``, ``task``, ``summary``): a worker of other tasks starts
without it.
"""

from aero_bayes.fleets.executors import open_executor
from aero_bayes.fleets.rigs import FleetFile, FleetPlan, Rig, read_fleet
from aero_bayes.fleets.runner import Table, run_tasks

__all__ = ["FleetFile", "FleetPlan", "Rig", "Table", "open_executor", "read_fleet", "run_tasks"]
