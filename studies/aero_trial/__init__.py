"""Simulated AEROs of the blind trial: drawn at random, some with an effect that no catalogue lists."""

from aero_trial.draw import ALL_KINDS, TrialSpec, draw_aero_trial

__all__ = ["ALL_KINDS", "TrialSpec", "draw_aero_trial"]
