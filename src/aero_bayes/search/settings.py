"""Settings of the search over structures."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class StructureSettings:
    """Settings of the beam search over structures."""

    min_share: float = 0.75
    beam_width: int = 5
    starts: int = 2
    min_predicted_gain: float = 2.0
    min_predicted_share: float = 0.1
    max_effects: int = 3
    require: tuple[str, ...] = ()
