"""From command-line options to run directories: what each command does, in order."""

from aero_bayes.progress import ProgressBar
from aero_bayes.workflow.commands import run_all, run_check, run_close_loop, run_fit, run_posterior
from aero_bayes.workflow.design import DesignOptions, run_design
from aero_bayes.workflow.diagram import model_diagrams
from aero_bayes.workflow.init import match_columns, run_init, split_unit
from aero_bayes.workflow.job import Job, RunOptions, open_job
from aero_bayes.workflow.loop import loop_settings
from aero_bayes.workflow.ports import run_ports
from aero_bayes.workflow.prediction import prediction_settings
from aero_bayes.workflow.results import versions, write_result, write_series
from aero_bayes.workflow.settings import fit_settings, sample_settings

__all__ = [
    "DesignOptions", "Job", "ProgressBar", "RunOptions", "fit_settings",
    "loop_settings", "match_columns", "model_diagrams", "open_job",
    "prediction_settings", "run_all", "run_check", "run_close_loop", "run_design",
    "run_fit", "run_init", "run_ports", "run_posterior", "sample_settings", "split_unit", "versions",
    "write_result", "write_series",
]  # fmt: skip
