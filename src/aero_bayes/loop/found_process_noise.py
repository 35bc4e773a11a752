"""Process noise that the loop found, as plain typed values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from aero_bayes.check.residual_tests import ResidualReport, reports_by_recording, structured_residuals
from aero_bayes.display import join_names, with_unit
from aero_bayes.estimate.process_noise import DIFFUSION_PREFIX
from aero_bayes.loop.found_effect import NewParameter
from aero_bayes.simulation.smoothing import SmoothedStates


@dataclass(frozen=True, eq=False)
class FoundProcessNoise:
    """The process noise that explains most of what the laws leave."""

    states: tuple[str, ...]
    explains: bool
    gain: float
    needed: float
    equivalent: tuple[tuple[str, ...], ...]
    parameters: Mapping[str, NewParameter]
    innovations: tuple[ResidualReport, ...]
    smoothed: Mapping[str, SmoothedStates]
    state_names: tuple[str, ...]

    @property
    def diffusions(self) -> dict[str, NewParameter]:
        """By state."""
        return {s: self.parameters[f"{DIFFUSION_PREFIX}{s}"] for s in self.states}

    @property
    def sentence(self) -> str:
        sizes = join_names([f"{s} ({with_unit(f'{p.value:.3g}', p.unit)})" for s, p in self.diffusions.items()])
        if self.explains:
            others = [join_names(list(states)) for states in self.equivalent]
            instead = f" Process noise of {' or of '.join(others)} explains it as well." if others else ""
            return (
                f"Process noise of {sizes} explains what is left: the filter's innovations are white. A random "
                f"disturbance that no law describes acts there.{instead}"
            )
        outputs = join_names(sorted({r.output for r in structured_residuals(self.innovations)}))
        return (
            f"Process noise does not explain what is left: with that of {sizes} the innovations of {outputs} are not "
            "white."
        )

    def to_dict(self) -> dict[str, object]:
        """Return it as ``loop.process_noise`` in result.json."""
        return {
            "states": list(self.states),
            "explains": self.explains,
            "sentence": self.sentence,
            "log_evidence_gain": self.gain,
            "needed": self.needed,
            "equivalent": [list(states) for states in self.equivalent],
            "parameters": {name: {**p.to_dict(), "description": p.description} for name, p in self.parameters.items()},
            "innovations": reports_by_recording(self.innovations),
        }
