"""What a loop's result does as the fit of the model that came out."""

from __future__ import annotations

from pathlib import Path

from aero_bayes.estimate.result import Fit


class FittedLoop:
    """The fit of the model that came out of a loop, and what is asked of it most."""

    after: Fit

    @property
    def fit(self) -> Fit:
        """The fit of the model that came out: what takes a fit takes the loop's result, too.

        Examples
        --------
        >>> loop.fit["k"].unit
        'N/m'
        """
        return self.after

    def summary(self) -> str:
        """Return the parameters of the model that came out as a table: value, 90 % interval, unit, status.

        Examples
        --------
        >>> loop.summary().splitlines()[0].split()[:2]
        ['parameter', 'value']
        """
        return self.after.summary()

    def to_matlab(self, path: Path | str) -> Path:
        """Write the values of the model that came out for MATLAB to a ``path``; see :meth:`Fit.to_matlab`.

        Examples
        --------
        >>> loop.to_matlab("loop.m").name
        'loop.m'
        """
        return self.after.to_matlab(path)
