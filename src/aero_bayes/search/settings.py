"""Settings of the search over structures."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class StructureSettings:
    """Settings of the beam search over structures.

    Parameters
    ----------
    min_share : float
        A structure is materially better than another if with it the left-out error of an output is at most this share.
    beam_width : int
        Structures of one size that are expanded.
    starts : int
        Starting points of a structure from which it is fitted.
    min_predicted_gain : float
        Gain in log-likelihood that a start must predict for a fit.
    min_predicted_share : float
        Share of the gain of the best structure of a level that a start must predict: a linear prediction is only a
        hint.
    max_effects : int
        Terms that a structure may have.
    require : tuple of str
        Terms that every structure has, without a test.
    """

    min_share: float = 0.75
    beam_width: int = 5
    starts: int = 2
    min_predicted_gain: float = 2.0
    min_predicted_share: float = 0.1
    max_effects: int = 3
    require: tuple[str, ...] = ()
