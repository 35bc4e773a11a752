"""What is known of the Quanser AERO before any recording is seen, as data.

Nominal values are Quanser's data sheet and user manual as quoted by Podlaski et al. (Table 1) and by the sources of the
measured recordings; the tolerances are wide enough for two benches that carry different propellers and springs.
``J_p`` and ``D_t`` are fixed because a recording sees only ratios to them (k_t D_t / J_p, D_p / J_p, K_sp / J_p), and
``J_s`` because it is seen only in the sum J_r + J_s.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from aero_bayes.estimate.parameters import Override
from aero_bayes.estimate.priors import LogNormal
from aero_bayes.simulation.model import Model

#: Steady thrust of the published linear gain, 4.5e-4 N s/rad at 371 rad/s, as a quadratic law's coefficient.
_K_T_QUADRATIC = 4.5e-4 / 371.0
#: Motor torque c_m i at 371 rad/s and 24 V / 2, spread over w^2.
_K_D_QUADRATIC = 3.0e-8
_LINEAR_ABOVE = 2.0e-5

#: The body may start at any pitch, at rest.
RESTING = ("theta",)

FIXED: Mapping[str, str] = MappingProxyType(
    {
        "J_p": "a recording sees only ratios to it",
        "D_t": "a recording sees only its product with k_t over J_p",
        "J_s": "it acts only in the sum J_r + J_s",
    }
)


def aero_overrides(model: Model) -> dict[str, Override]:
    """Priors of the free parameters of the AERO models, for the thrust law that the model carries.

    The law is read off the model's own nominal thrust coefficient: of order 1e-6 N s^2/rad^2 for the quadratic law and
    of order 1e-4 N s/rad for the linear one.
    """
    nominal = {v.name: (v.start if v.start is not None else v.nominal) for v in model.parameters}
    if not {"J_p", "D_t", "K_sp", "k_t", "c_m"} <= nominal.keys():
        return {}
    k_t, k_d = nominal.get("k_t") or _K_T_QUADRATIC, nominal.get("k_d") or _K_D_QUADRATIC
    linear = k_t > _LINEAR_ABOVE
    drag = abs(k_d) if linear else k_d
    overrides = {
        "R_a": _around(8.4, LogNormal.tolerance(8.4, 0.15), 4.0),
        "c_m": _around(0.042, LogNormal.tolerance(0.042, 0.10), 3.0),
        "J_r": _around(nominal.get("J_r") or 4.0e-6, LogNormal.factor(1.1e-5, 2.0), 30.0),
        "k_d": _around(drag, LogNormal.factor(drag, 3.0), 300.0),
        "k_t": _around(k_t, LogNormal.factor(k_t, 3.0), 100.0),
        "D_p": _around(0.0071, LogNormal.factor(0.0071, 2.0), 30.0),
        "K_sp": _around(0.0375, LogNormal.factor(0.0375, 2.0), 30.0),
        "L_a": _around(1.16e-3, LogNormal.factor(1.16e-3, 1.5), 10.0, auto=True),
    }
    return {name: override for name, override in overrides.items() if name in nominal}


def _around(start: float, prior: LogNormal, factor: float, *, auto: bool = False) -> Override:
    """Bounds a factor below the smaller and above the larger of start and prior median."""
    low, high = min(start, prior.median), max(start, prior.median)
    return Override(start, low / factor, high * factor, prior, "log", auto)
