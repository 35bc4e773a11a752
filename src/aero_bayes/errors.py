"""Errors with one line for the user, and their exit status on the command line."""

from __future__ import annotations


class InputError(ValueError):
    """An input of the user is wrong (exit status 2). The message names what, where, and what was expected.

    What to do is said as one does it in Python; ``configured`` has the message of the command line, where it is written
    into the configuration.

    Examples
    --------
    >>> recording.slice(90.0, 100.0)
    Traceback (most recent call last):
    aero_bayes.errors.InputError: train: no sample between 90 s and 100 s (it runs from 0 s to 40 s)
    """

    def __init__(self, message: str, configured: str = "") -> None:
        super().__init__(message)
        self.configured = configured or message


class CannotFinishError(RuntimeError):
    """The work cannot be completed although the input is valid (exit status 3). The message says why.

    Examples
    --------
    >>> fit.simulate({"time": [0.0, 1.0], "F": 0.0}, parameters={"m": 0.0})  # a cart without mass
    Traceback (most recent call last):
    aero_bayes.errors.CannotFinishError: Rig could not be simulated: ...
    """
