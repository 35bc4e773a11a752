"""Rigs and recordings for the blind trial, drawn at random; the truth stays apart from the recordings."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import exp, log
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.random import Generator

from aero_bayes.data import Recording, write_csv
from aero_bayes.errors import InputError
from aero_trial import outside
from simulated_aero import EffectKind, effects
from simulated_aero.defaults import SimulatedSet, write_truth
from simulated_aero.inputs import InputDesign, random_levels
from simulated_aero.rig import simulate_recording
from simulated_aero.sensors import Sensors, clean, real, white
from simulated_aero.truth import EffectTruth, Parameters, Truth

Kind = Literal["single", "none", "pair", "outside"]
NoiseKind = Literal["white", "real"]
#: Parameters that differ from rig to rig, and by how much at most.
VARIED = ("R_a", "c_m", "J", "k_d", "k_t", "D_p", "K_sp")
MAX_SPREAD = 0.15
#: All effects that a trial may draw, by id.
ALL_KINDS = effects.KINDS | outside.KINDS
#: The input delay in s of a rig with real noise.
REAL_DELAY = 0.006


@dataclass(frozen=True)
class TrialSpec:
    """One blind trial: a rig, its sensors, and the experiments made with it."""

    kind: Kind
    noise: NoiseKind
    truth: Truth
    sensors: Sensors
    train: InputDesign
    test: InputDesign
    entropy: int
    duration: float = 60.0
    rate_hz: float = 100.0

    def record(self) -> SimulatedSet:
        """Make the recordings. The same trial always gives the same numbers."""
        return SimulatedSet((self.recording("train"),), (self.recording("test"),), self.truth, self.sensors)

    def recording(self, name: Literal["train", "test"]) -> Recording:
        """Make one of the two recordings alone."""
        index = ("train", "test").index(name)
        stream = np.random.default_rng(self.entropy).spawn(2)[index]
        design = (self.train, self.test)[index]
        return simulate_recording(
            self.truth, design, self.sensors, stream,
            duration=self.duration, rate_hz=self.rate_hz, name=name, kinds=ALL_KINDS,
        )  # fmt: skip

    def noise_free(self) -> TrialSpec:
        """Return the same trial with sensors that add nothing."""
        return replace(self, sensors=clean())

    def write(self, made: SimulatedSet, recordings: Path | str, truth: Path | str) -> tuple[Path, Path]:
        """Write what :meth:`record` made, ``train.csv`` and ``test.csv``, to one folder and the truth elsewhere."""
        train = write_csv(made.train[0], Path(recordings) / "train.csv")
        test = write_csv(made.test[0], Path(recordings) / "test.csv")
        Path(truth).parent.mkdir(parents=True, exist_ok=True)
        write_truth(Path(truth), self.truth, self.sensors, [*made.train, *made.test])
        return train, test


def draw_aero_trial(rng: Generator, kind: Kind = "single", noise: NoiseKind = "white") -> TrialSpec:
    """Draw a trial.

    Parameters
    ----------
    rng : Generator
    kind : {"single", "none", "pair", "outside"}
        One effect of the catalogue, none, two different ones, or one that no catalogue lists.
    noise : {"white", "real"}
        White noise of a random level, or the noise of a real AERO with its 6 ms input delay.

    Raises
    ------
    InputError
        For another kind.
    """
    if kind not in ("single", "none", "pair", "outside") or noise not in ("white", "real"):
        raise InputError(f"bench: no trial of kind {kind!r} with noise {noise!r}")
    factors = {name: float(rng.uniform(1.0 - MAX_SPREAD, 1.0 + MAX_SPREAD)) for name in VARIED}
    known, unknown = list(effects.KINDS.values()), list(outside.KINDS.values())
    chosen: list[EffectKind] = []
    if kind == "single":
        chosen = [known[int(rng.integers(len(known)))]]
    elif kind == "pair":
        chosen = [known[int(index)] for index in rng.choice(len(known), 2, replace=False)]
    elif kind == "outside":
        chosen = [unknown[int(rng.integers(len(unknown)))]]
    truth = Truth(
        "one_dof",
        Parameters().scaled(factors),
        tuple(draw_effect(rng, one) for one in chosen),
        REAL_DELAY if noise == "real" else 0.0,
    )
    level = exp(float(rng.uniform(log(0.3), log(2.0)))) if noise == "white" else float(rng.uniform(0.7, 1.3))
    return TrialSpec(
        kind,
        noise,
        truth,
        white(level) if noise == "white" else real(level),
        random_levels(rng, 20.0, 60.0),
        random_levels(rng, 18.0, 60.0),
        int(rng.integers(2**63)),
    )


def draw_effect(rng: Generator, kind: EffectKind) -> EffectTruth:
    """Draw the parameters of an effect, each uniform in its logarithm; a signed magnitude gets a random sign."""
    values = {name: exp(float(rng.uniform(log(low), log(high)))) for name, (low, high) in kind.ranges.items()}
    if kind.signed and rng.random() < 0.5:
        values[kind.magnitude] *= -1.0
    return kind.truth(**values)
