"""What a reader is told of the noise: its table, and warnings where a residual is not noise."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.measured_data import MeasuredData
from aero_bayes.estimate.parameter_estimates import Estimate
from aero_bayes.estimate.process_noise import DIFFUSION_PREFIX
from aero_bayes.sensors.noise import OutputNoise
from aero_bayes.sensors.whiteness import block_variance_ratio
from aero_bayes.simulation.interface import ProcessNoise

#: Variance of averages over that of white noise above which a reader is warned.
MAX_NOISE_EXCESS = 2.0


def noise_table(data: MeasuredData, noise: Mapping[str, OutputNoise]) -> dict[str, dict[str, object]]:
    """Write the noise by output for result.json: ``sd`` and lag-one ``rho`` at the sample interval, and their parts."""
    table = noise_at_interval(noise, float(np.median(np.concatenate([np.diff(e.time) for e in data.experiments]))))
    for name, spread in data.spreads.items():
        table[name] |= {"kind": spread.kind, "base": spread.base}
        if spread.kind != "constant":
            table[name] |= {"freedom": spread.freedom} if spread.kind == "student" else {"per_unit": spread.per_unit}
        if spread.scales:
            table[name]["by_recording"] = noise_by_recording(data, name, noise[name].sd)
    return table


def noise_by_recording(data: MeasuredData, output: str, sd: float) -> dict[str, float]:
    """Return the standard deviation of an output's noise in each recording that has it, from that over all readings."""
    column, found = data.outputs.index(output), {}
    for name, experiment, measured in zip(data.names, data.experiments, data.measured, strict=True):
        seen = np.isfinite(measured[:, column])
        if seen.any() and experiment.spread is not None:
            found[name] = sd * float(np.sqrt(np.mean(experiment.spread[seen, column] ** 2)))
    return found


def noise_at_interval(noise: Mapping[str, OutputNoise], interval: float) -> dict[str, dict[str, object]]:
    """Describe the noise by output, with its correlation ``rho`` over a sample interval in s."""
    return {
        name: {"sd": n.sd, "rho": n.rho(interval), "sd_white": n.sd_white, "sd_ou": n.sd_ou, "tau_s": n.tau}
        for name, n in noise.items()
    }


def process_noise_table(process: ProcessNoise | None, parameters: Mapping[str, Estimate]) -> dict[str, object]:
    """Write the diffusion by state as result.json has it, with the spread of those that were estimated."""
    given = process.diffusion if process is not None else {}
    table: dict[str, object] = {name: {"value": value} for name, value in given.items()}
    for name, estimate in parameters.items():
        if name.startswith(DIFFUSION_PREFIX):
            table[name.removeprefix(DIFFUSION_PREFIX)] = estimate.to_dict()
    return table


def structure_warnings(
    calibration: Calibration, innovations: Mapping[str, FloatArray], noise: Mapping[str, OutputNoise]
) -> tuple[str, ...]:
    """Return one sentence for each output whose residual the noise cannot explain.

    ``innovations`` are whitened residuals."""
    units = calibration.model.units
    lines = []
    for name in calibration.data.outputs:
        n, unit = noise[name], units.get(name, "")
        if n.model_error:
            lines.append(
                f"The model does not explain {name}: its residual of {n.sd:.3g} {unit} is not sensor noise. The fit "
                "weights it as least squares does. The intervals are those of the values that describe experiments of "
                "this kind best. The true values may lie outside of them."
            )
            continue
        excess = block_variance_ratio(innovations[name])
        if excess > MAX_NOISE_EXCESS:
            lines.append(
                f"The residual of {name} changes more slowly than its noise model allows: averages have {excess:.1f} "
                "times the expected variance, so that its intervals are too narrow."
            )
    return tuple(lines)
