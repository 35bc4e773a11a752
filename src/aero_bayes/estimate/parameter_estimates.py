"""A parameter with its interval and status, and tables of parameters for readers."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from aero_bayes.display import table_html
from aero_bayes.estimate.calibration import Calibration
from aero_bayes.estimate.identifiability import Status
from aero_bayes.simulation.interface import ParameterTarget
from aero_bayes.simulation.model import Model

Json = dict[str, object]


@dataclass(frozen=True)
class Estimate:
    """Value and interval of one parameter; ``sd`` and the quantiles are None where the data do not determine it."""

    name: str
    value: float
    sd: float | None
    q05: float | None
    q50: float | None
    q95: float | None
    unit: str
    status: Status
    description: str = ""
    prior: str = ""
    start: float | None = None
    lower: float | None = None
    upper: float | None = None
    note: str = ""
    recording: str = ""

    def __float__(self) -> float:
        return self.value

    def to_dict(self) -> Json:
        """Return the entry of result.json."""
        return {key: (str(v) if isinstance(v, Status) else v) for key, v in self.__dict__.items() if key != "name"}


def estimates_html(table: Mapping[str, Estimate], caption: str, warnings: Sequence[str] = ()) -> str:
    """Return a table of parameters for a notebook."""
    rows = []
    for e in table.values():
        span = "" if e.q05 is None or e.q95 is None else f"{e.q05:.4g} to {e.q95:.4g}"
        rows.append((e.name, f"{e.value:.4g}", span, e.unit, str(e.status), e.prior))
    return table_html(("parameter", "value", "90 % interval", "unit", "status", "prior"), rows, caption, warnings)


def fixed_reasons(model: Model, fixed: Collection[str]) -> dict[str, str]:
    """Say why parameters of a model are not fitted, by name; ``fixed`` are those that the configuration sets."""
    return {name: "held at the value that the configuration gives" for name in fixed} | dict(model.declared.fixed)


def fixed_parameters(calibration: Calibration) -> dict[str, Estimate]:
    """List parameters of the model that are not fitted, where the reason is known."""
    fitted = {p.target.name for p in calibration.parameters if isinstance(p.target, ParameterTarget)}
    reasons = fixed_reasons(calibration.model, calibration.simulated.fixed)
    table = {}
    for v in calibration.model.parameters:
        value, note = calibration.simulated.fixed.get(v.name, v.start), reasons.get(v.name)
        if v.name not in fitted and note is not None and value is not None:
            table[v.name] = Estimate(
                v.name, float(value), None, None, None, None, v.unit, Status.FIXED, v.description, note=note
            )
    for recording in calibration.data.recordings:
        for name, value in recording.known.items():
            v = calibration.model.parameter(name)
            table[f"{name}@{recording.name}"] = Estimate(
                f"{name}@{recording.name}", value, None, None, None, None, v.unit, Status.FIXED, v.description,
                note="known in this recording", recording=recording.name,
            )  # fmt: skip
    return table
