"""The affine-invariant stretch move."""

from __future__ import annotations

from emcee.moves import StretchMove as _StretchMove


class StretchMove(_StretchMove):  # type: ignore[misc]
    """Move a walker along the line to one of the other half of its ensemble.

    It needs no knowledge of the target, and is slow in many dimensions.
    Goodman and Weare (2010), Comm. App. Math. Comp. Sci. 5, 65."""
