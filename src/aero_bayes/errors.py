"""Errors that a user can mend: one clear line each, exit status 2 on the command line."""

from __future__ import annotations


class InputError(ValueError):
    """Something the user gave is wrong; the message names what, where, and what was expected."""


class CannotFinishError(RuntimeError):
    """The work could not be completed with valid input (exit status 3); the message says why."""
