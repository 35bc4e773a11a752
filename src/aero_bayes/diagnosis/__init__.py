"""The diagnosis of a fit: data, solver, search, noise and model, looked at in this order."""

from aero_bayes.diagnosis.diagnose import diagnose

__all__ = ["diagnose"]
