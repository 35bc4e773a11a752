"""Settings of the search over structures."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class StructureSettings:
    """When a structure is kept, and how much is tried.

    Parameters
    ----------
    margin : float
        Log-evidence that each term has to gain beyond the logarithm of the number of candidates.
    equivalence : float
        Difference in log-evidence within which the data do not tell two terms apart (a hundred to one).
    beam : int
        Structures of one size that are expanded.
    within : float
        Honest log-evidence by which a structure may be behind the best of its size and still be expanded.
    starts : int
        Starting points of a structure from which it is fitted.
    promise : float
        Gain in log-likelihood that a start must promise for a fit.
    promise_share : float
        Share of what a structure has to gain that its starts must promise: lines are hints only.
    max_effects : int
        Terms that a structure may have.
    require : tuple of str
        Terms that every structure has, whatever they gain.
    """

    margin: float = 4.0
    equivalence: float = 4.6
    beam: int = 5
    within: float = 25.0
    starts: int = 2
    promise: float = 2.0
    promise_share: float = 0.1
    max_effects: int = 3
    require: tuple[str, ...] = ()
