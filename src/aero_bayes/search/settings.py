"""Settings of the search over structures."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class StructureSettings:
    """Settings of the beam search over structures.

    Parameters
    ----------
    margin : float
        Log-evidence that each term has to gain beyond the logarithm of the number of candidates.
    equivalence : float
        Difference in log-evidence within which the data do not tell two terms apart (a hundred to one).
    beam_width : int
        Structures of one size that are expanded.
    beam_margin : float
        Tempered log-evidence by which a structure may be behind the best of its size and still be expanded.
    starts : int
        Starting points of a structure from which it is fitted.
    min_predicted_gain : float
        Gain in log-likelihood that a start must predict for a fit.
    min_predicted_share : float
        Share of the needed gain that the starts of a structure must predict: a linear prediction is only a hint.
    max_effects : int
        Terms that a structure may have.
    require : tuple of str
        Terms that every structure has, without a test.
    """

    margin: float = 4.0
    equivalence: float = 4.6
    beam_width: int = 5
    beam_margin: float = 25.0
    starts: int = 2
    min_predicted_gain: float = 2.0
    min_predicted_share: float = 0.1
    max_effects: int = 3
    require: tuple[str, ...] = ()
