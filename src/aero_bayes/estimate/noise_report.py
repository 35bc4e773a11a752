"""What a reader is told of the noise: its table, and warnings where a residual is not noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from aero_bayes.estimate.calibration import Calibration
from aero_bayes.sensors.noise import OutputNoise, innovations
from aero_bayes.sensors.whiteness import slow_excess

#: Variance of averages over that of white noise above which a reader is warned.
MAX_SLOW_EXCESS = 2.0


def noise_table(calibration: Calibration, noise: Mapping[str, OutputNoise]) -> dict[str, dict[str, object]]:
    """Noise by output as result.json has it: ``sd`` and lag-one ``rho`` at the sample interval, and their parts."""
    interval = float(np.median(np.concatenate([np.diff(e.time) for e in calibration.experiments])))
    return {
        name: {"sd": n.sd, "rho": n.rho(interval), "sd_white": n.sd_white, "sd_ou": n.sd_ou, "tau_s": n.tau}
        for name, n in noise.items()
    }


def structure_warnings(
    calibration: Calibration, residuals: Sequence[NDArray[np.float64]], noise: Mapping[str, OutputNoise]
) -> tuple[str, ...]:
    """One sentence for each output whose residual the sensors cannot explain."""
    units = {v.name: v.unit for v in calibration.model.outputs}
    lines = []
    for k, name in enumerate(calibration.outputs):
        n, unit = noise[name], units.get(name, "")
        if n.held:
            lines.append(
                f"The model does not explain {name}: its residual of {n.sd:.3g} {unit} is not sensor noise. The fit "
                "weights it as least squares does. Its intervals are enlarged because the residual is not white; a "
                "systematic error of the model can still lie outside of them."
            )
            continue
        white = [innovations(e.time, r[:, k], n) for e, r in zip(calibration.experiments, residuals, strict=True)]
        excess = slow_excess(np.concatenate(white))
        if excess > MAX_SLOW_EXCESS:
            lines.append(
                f"The residual of {name} changes more slowly than its noise model allows: averages have {excess:.1f} "
                "times the expected variance, so that its intervals are too narrow."
            )
    return tuple(lines)
