"""The affine-invariant stretch move."""

from __future__ import annotations

from emcee.moves import StretchMove as _StretchMove


class StretchMove(_StretchMove):  # type: ignore[misc]
    """A walker moves along the line to one of the other half of its ensemble.

    Needs nothing known of the target and finds its way from a poor start, slowly in many dimensions.
    Goodman and Weare (2010), Comm. App. Math. Comp. Sci. 5, 65.
    """
