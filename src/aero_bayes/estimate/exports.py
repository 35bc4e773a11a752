"""Values of a fit in the files of other tools: a Modelica class, an FMU, MATLAB, a Dymola script."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from aero_bayes.arrays import FloatArray
from aero_bayes.display import with_unit
from aero_bayes.errors import InputError
from aero_bayes.estimate.calibrated_model import CalibratedModel, ListedValue, calibrated_model, value_text, values_text
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.identifiability import Estimate
from aero_bayes.estimate.initial_states import DIFFUSION_PREFIX
from aero_bayes.estimate.intervals import Laplace
from aero_bayes.estimate.measured_data import MeasuredData
from aero_bayes.estimate.noise import OutputNoise, block_variance_ratio
from aero_bayes.estimate.prediction import FittedResult
from aero_bayes.files import whole_file, write_whole
from aero_bayes.plain import INTERNAL, Number, plain
from aero_bayes.simulation.interface import ParameterTarget, ProcessNoise, StartTarget

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
            table[name.removeprefix(DIFFUSION_PREFIX)] = plain(estimate)
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


Json = dict[str, object]


@dataclass(frozen=True)
class ValueTrial:
    """A fit with some values of the listed parameters."""

    values: Mapping[str, ListedValue]
    numbers: Mapping[str, float] = field(default_factory=dict, metadata=INTERNAL)
    modifiers: Mapping[str, str] = field(default_factory=dict, metadata=INTERNAL)
    share: Number = 0.0
    worse_by: Number = math.inf
    failed: str = ""


def chosen_estimates(trials: Sequence[ValueTrial]) -> dict[str, Estimate]:
    """Return the listed parameters as entries of the table of parameters."""
    table = {}
    for name, value in trials[0].values.items() if trials else ():
        tried = ", ".join(dict.fromkeys(value_text(t.values[name]) for t in trials))
        told = f"{value_text(value)}: likeliest of {tried}"
        table[name] = Estimate.held(name, trials[0].numbers[name], "", told)
    return table


def trials_sentence(trials: Sequence[ValueTrial]) -> str:
    """Say which of the listed values is reported, and how much worse the others are; empty where none are listed."""
    if not trials:
        return ""
    others = [
        f"{values_text(t.values)} failed" if t.failed else f"{values_text(t.values)} ({_percent(t.share)} likely, "
        f"log-posterior lower by {t.worse_by:.3g})"
        for t in trials[1:]
    ]  # fmt: skip
    beside = f"; others: {', '.join(others)}" if others else ""
    best = f"{values_text(trials[0].values)} is reported ({_percent(trials[0].share)} likely)"
    return f"Of the listed values {best}{beside}."


def _percent(share: float) -> str:
    if share < 1e-3:
        return "less than 0.1 %"
    return "more than 99.9 %" if share > 0.999 else f"{100.0 * share:.3g} %"


#: Longest name that MATLAB takes (its ``namelengthmax``).
MATLAB_NAME = 63


class OtherTools(FittedResult):
    """A fitted model for other tools: a Modelica class, an FMU, MATLAB, Dymola; :class:`Fit` describes the fields."""

    calibration: Calibration
    laplace: Laplace
    values: FloatArray
    free: tuple[int, ...]
    trials: tuple[ValueTrial, ...]

    @property
    def calibrated(self) -> CalibratedModel:
        """The model with all values of the fit, as Modelica; InputError where its source is not known.

        Examples
        --------
        >>> fit.calibrated.write("fitted").name
        'Rig_fitted.mo'
        """
        return calibrated_model(
            self.calibration, self.values, self.parameters, chosen=self.trials[0].modifiers if self.trials else None
        )

    def export_fmu(self, path: Path | str) -> Path:
        """Write the FMU of the model with all values of the fit.

        Parameters
        ----------
        path : path
            The FMU; it appears whole or not at all.

        Raises
        ------
        InputError
            For a model that was given as an FMU: its values cannot be changed in there.

        Examples
        --------
        >>> fitted = aero_bayes.load_model(fit.export_fmu("Rig_fitted.fmu"))
        >>> round(fitted.parameter("k").start, 1)
        54.9
        """
        return self.calibrated.export_fmu(path)

    @property
    def parameter_covariance(self) -> FloatArray:
        """Covariance of the fitted parameters in SI units, shape (len(free), len(free)), to first order.

        Examples
        --------
        >>> k = fit.free.index(fit.calibration.parameters.index("k"))
        >>> bool(np.isclose(fit.parameter_covariance[k, k] ** 0.5, fit["k"].sd))  # N/m
        True
        """
        count = len(self.free)
        slopes = self.calibration.parameters.jacobian(self.values)[list(self.free)]
        found = self.laplace.covariance[:count, :count] * np.outer(slopes, slopes)
        return np.asarray(0.5 * (found + found.T))  # rounding leaves it not quite symmetric, which MATLAB refuses

    def to_modelica(self) -> str:
        """Return the Modelica class with all values of the fit, as text; it extends the class that was fitted.

        Raises
        ------
        InputError
            Where the model came as an FMU, so that its source is not known.

        Examples
        --------
        >>> print(fit.to_modelica().splitlines()[1])
        model Rig_fitted "Rig with the values of a fit"
        """
        return self.calibrated.text

    def to_matlab(self, path: Path | str) -> Path:
        """Write values, standard deviations, covariance and units for MATLAB, as a structure ``fitted``.

        Parameters
        ----------
        path : path
            With the ending ``.mat`` (version 5), or ``.m`` for a script that says the same. What the data do not
            determine has ``NaN`` for its ``sd``. ``fitted.parameter`` has the values by name, with ``_`` where MATLAB
            allows no other sign; ``fitted.covariance`` belongs to ``fitted.covariance_of``.

        Returns
        -------
        Path
            ``path``.

        Raises
        ------
        InputError
            For another ending, or a folder that is not there.

        Examples
        --------
        >>> from scipy.io import loadmat
        >>> read = loadmat(fit.to_matlab("fit.mat"), simplify_cells=True)["fitted"]
        >>> bool(read["parameter"]["k"] == fit["k"].value), read["unit"][0], read["covariance"].shape
        (True, 'N/m', (2, 2))
        """
        path = _target(path, (".m", ".mat"))
        content = self._matlab_content()
        with whole_file(path) as temporary:
            if path.suffix == ".mat":
                from scipy.io import savemat

                savemat(temporary, {"fitted": {key: _cells(value) for key, value in content.items()}}, oned_as="column")
            else:
                lines = [f"% {line}" for line in self._about()] + ["clear fitted"]
                lines += [line for key, value in content.items() for line in _matlab_lines(f"fitted.{key}", value)]
                temporary.write_text("\n".join([*lines, ""]), encoding="utf-8")
        return path

    def to_dymola(self, path: Path | str) -> Path:
        """Write a Dymola script (``.mos``) that translates the fitted class's model, sets the values and simulates.

        Parameters
        ----------
        path : path
            With the ending ``.mos``. Initial values of the first recording are set as well; its delays are comments.

        Returns
        -------
        Path
            ``path``.

        Raises
        ------
        InputError
            For another ending, or a folder that is not there.

        Examples
        --------
        >>> script = fit.to_dymola("set_values.mos").read_text()
        >>> [line for line in script.splitlines() if line.startswith("simulateModel")]
        ['simulateModel("Rig", stopTime=40);']
        """
        path = _target(path, (".mos",))
        calibration = self.calibration
        source = calibration.model.source
        files = source.files if source is not None else ()
        name = source.name if source is not None else calibration.model.name
        lines = [f"// {line}" for line in self._about()]
        lines += [f'openModel("{file.as_posix()}");' for file in files] + [f'translateModel("{name}");']
        units = calibration.model.units
        given = [(held, value, units.get(held, "")) for held, value in calibration.fixed.items()]
        for p, value in zip(calibration.parameters, self.values.tolist(), strict=True):
            if isinstance(p.target, ParameterTarget | StartTarget) and p.acts_in(0):
                told = p.target.name if isinstance(p.target, ParameterTarget) else p.target.state
                given.append((told, value, p.unit))
            elif p.acts_in(0):
                lines.append(f"// {with_unit(f'{p.name} = {value!r}', p.unit)}: {p.description}, not in the model")
        lines += [with_unit(f"{told} = {value!r};  //", unit).removesuffix("  //") for told, value, unit in given]
        lines.append(f'simulateModel("{name}", stopTime={calibration.data.stop:.12g});')
        return write_whole(path, "\n".join([*lines, ""]))

    def _about(self) -> list[str]:
        data = ", ".join(self.calibration.data.names)
        return [f"{self.calibration.model.name}, fitted to {data} by aero-bayes", "Values in SI units."]

    def _matlab_content(self) -> dict[str, Any]:
        table = self.parameters
        entries = list(table.values())
        names = self.calibration.parameters.names
        return {
            "model": self.calibration.model.name,
            "name": [e.name for e in entries],
            "value": np.array([e.value for e in entries]),
            **{
                key: np.array([np.nan if (v := getattr(e, key)) is None else v for e in entries])
                for key in ("sd", "q05", "q95")
            },
            "unit": [e.unit for e in entries],
            "status": [str(e.status) for e in entries],
            "covariance": self.parameter_covariance,
            "covariance_of": [names[column] for column in self.free],
            "parameter": dict(zip(_matlab_names(list(table)), (e.value for e in entries), strict=True)),
        }


def _target(path: Path | str, endings: Sequence[str]) -> Path:
    path = Path(path)
    if path.suffix not in endings:
        raise InputError(f"{path}: expected a name that ends in {' or '.join(endings)}")
    if not path.parent.is_dir():
        raise InputError(f"{path.parent}: no such folder")
    return path


def _matlab_names(names: Sequence[str]) -> list[str]:
    """Return names as MATLAB allows them, each once."""
    found: list[str] = []
    for name in names:
        plain = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_")[: MATLAB_NAME - 4]
        plain = plain if plain[:1].isalpha() else f"p_{plain}"
        others = (f"{plain}_{k}" for k in range(2, len(names) + 2))
        found.append(plain if plain not in found else next(other for other in others if other not in found))
    return found


def _cells(value: Any) -> Any:
    """Write lists of texts as MATLAB's cell arrays."""
    return np.array(value, dtype=object) if isinstance(value, list) else value


def _matlab_lines(name: str, value: Any) -> list[str]:
    """Write assignments that give a variable of MATLAB a value, a list of texts, a matrix or fields."""
    if isinstance(value, Mapping):
        return [line for key, v in value.items() for line in _matlab_lines(f"{name}.{key}", v)]
    return [f"{name} = {_matlab_text(value)};"]


def _matlab_text(value: Any) -> str:
    if isinstance(value, str):
        return "'{}'".format(value.replace("'", "''"))
    if isinstance(value, list):
        return f"{{{'; '.join(map(_matlab_text, value))}}}"
    rows = np.asarray(value, dtype=float)
    if rows.ndim == 0:
        return "NaN" if np.isnan(rows) else repr(float(rows))
    return f"[{'; '.join(' '.join(_matlab_text(x) for x in np.atleast_1d(row)) for row in rows)}]"
