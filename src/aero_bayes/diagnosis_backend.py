"""How a fit gets its diagnosis without importing the checks that make it.

The checks in ``diagnosis`` import the classes of a fit, so that a fit cannot import them. It asks the function that the
package registers (``aero_bayes/__init__.py``).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from aero_bayes.estimate.diagnosis import Diagnosis
    from aero_bayes.estimate.result import Fit

_loaders: list[Callable[[], Callable[[Fit], Diagnosis]]] = []


def register_diagnosis(load: Callable[[], Callable[[Fit], Diagnosis]]) -> None:
    """Make the function that ``load`` returns the one that diagnoses fits."""
    _loaders[:] = [load]


def diagnosis_of(fit: Fit) -> Diagnosis:
    """Return the diagnosis of a fit by the registered function."""
    return _loaders[-1]()(fit)
