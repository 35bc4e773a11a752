"""Many rigs of one model, on whatever workers the user brings.

What fits and summarises is imported from its files (``whole``, ``task``, ``summary``): a worker of other tasks starts
without it.
"""

from aero_bayes.commands.commands import run_all, run_check, run_close_loop, run_fit
from aero_bayes.commands.context import model_diagrams
from aero_bayes.commands.design import DesignOptions, run_design
from aero_bayes.commands.fleet import FleetFile, FleetPlan, Rig, read_fleet
from aero_bayes.commands.fleet_runner import Table, open_executor, run_tasks
from aero_bayes.commands.init import match_columns, run_init, split_unit
from aero_bayes.commands.job import Job, RunOptions, open_job
from aero_bayes.commands.loop import fit_settings, loop_settings, sample_settings
from aero_bayes.commands.ports import run_ports
from aero_bayes.progress import ProgressBar
from aero_bayes.report.results import versions, write_result, write_series

__all__ = [
    "DesignOptions",
    "FleetFile",
    "FleetPlan",
    "Job",
    "ProgressBar",
    "Rig",
    "RunOptions",
    "Table",
    "fit_settings",
    "loop_settings",
    "match_columns",
    "model_diagrams",
    "open_executor",
    "open_job",
    "read_fleet",
    "run_all",
    "run_check",
    "run_close_loop",
    "run_design",
    "run_fit",
    "run_init",
    "run_ports",
    "run_tasks",
    "sample_settings",
    "split_unit",
    "versions",
    "write_result",
    "write_series",
]
