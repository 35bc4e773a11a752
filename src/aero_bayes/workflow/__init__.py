"""From command-line options to run directories: what each command does, in order."""

from __future__ import annotations

from typing import TYPE_CHECKING

from aero_bayes.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from aero_bayes.workflow.commands import run_all as run_all
    from aero_bayes.workflow.commands import run_check as run_check
    from aero_bayes.workflow.commands import run_close_loop as run_close_loop
    from aero_bayes.workflow.commands import run_fit as run_fit
    from aero_bayes.workflow.commands import run_posterior as run_posterior
    from aero_bayes.workflow.commands import write_page as write_page
    from aero_bayes.workflow.curves import band_series as band_series
    from aero_bayes.workflow.curves import fitted_series as fitted_series
    from aero_bayes.workflow.curves import measured_series as measured_series
    from aero_bayes.workflow.curves import only_measured as only_measured
    from aero_bayes.workflow.curves import ripple_series as ripple_series
    from aero_bayes.workflow.describe import recording_row as recording_row
    from aero_bayes.workflow.design import DesignOptions as DesignOptions
    from aero_bayes.workflow.design import run_design as run_design
    from aero_bayes.workflow.diagram import model_diagrams as model_diagrams
    from aero_bayes.workflow.init import match_columns as match_columns
    from aero_bayes.workflow.init import run_init as run_init
    from aero_bayes.workflow.init import split_unit as split_unit
    from aero_bayes.workflow.job import Job as Job
    from aero_bayes.workflow.job import RunOptions as RunOptions
    from aero_bayes.workflow.job import open_job as open_job
    from aero_bayes.workflow.loop import loop_settings as loop_settings
    from aero_bayes.workflow.ports import run_ports as run_ports
    from aero_bayes.workflow.prediction import prediction_settings as prediction_settings
    from aero_bayes.workflow.progress import ProgressBar as ProgressBar
    from aero_bayes.workflow.results import plain as plain
    from aero_bayes.workflow.results import versions as versions
    from aero_bayes.workflow.results import write_result as write_result
    from aero_bayes.workflow.results import write_series as write_series
    from aero_bayes.workflow.settings import fit_settings as fit_settings
    from aero_bayes.workflow.settings import sample_settings as sample_settings

__getattr__, __dir__ = lazy_exports(
    __name__,
    {
        "commands": "run_all run_check run_close_loop run_fit run_posterior write_page",
        "curves": "band_series fitted_series measured_series only_measured ripple_series",
        "describe": "recording_row",
        "design": "DesignOptions run_design",
        "diagram": "model_diagrams",
        "init": "match_columns run_init split_unit",
        "job": "Job RunOptions open_job",
        "loop": "loop_settings",
        "ports": "run_ports",
        "prediction": "prediction_settings",
        "progress": "ProgressBar",
        "results": "plain versions write_result write_series",
        "settings": "fit_settings sample_settings",
    },
)
