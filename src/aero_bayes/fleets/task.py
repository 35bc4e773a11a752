"""One rig is one task: its recordings and settings go in, its run directory and its row come out."""

from __future__ import annotations

import contextlib
import hashlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from aero_bayes.config import Config
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.parameters import Parameter
from aero_bayes.fleets.rigs import Rig, Work
from aero_bayes.fleets.runner import Row, failure
from aero_bayes.report.run_directory import RunDirectory
from aero_bayes.schema import EffectJson, LoopJson, ParameterJson, RunJson
from aero_bayes.simulation import Model
from aero_bayes.simulation.gaussian import NORMAL_HALF_WIDTH
from aero_bayes.workflow.commands import run_all, run_close_loop, run_fit, run_posterior
from aero_bayes.workflow.job import RunOptions, fit_parameters

#: Folder of the rigs' run directories, and what each says while it runs.
RUNS, LOG = "rigs", "log.txt"
#: What a row is, so that rows of an older kind are computed anew.
KIND = 4
#: A rig whose likelihood has less than this share of its posterior's precision tells only its prior.
MIN_LIKELIHOOD_SHARE = 0.05
_COMMANDS: Mapping[Work, Callable[[Rig, RunOptions], None]] = {
    "fit": lambda rig, options: run_fit(rig.train, options),
    "posterior": lambda rig, options: run_posterior(rig.train, options),
    "loop": lambda rig, options: run_close_loop(rig.train, rig.test, options),
    "all": lambda rig, options: run_all(rig.train, rig.test, options),
}


@dataclass(frozen=True)
class RigTask:
    """Everything that a worker needs; the files must be readable on its machine."""

    rig: Rig
    config: Config | str
    work: Work
    out: Path
    seed: int
    model: Path | None = None

    @property
    def key(self) -> str:
        """The rig's name."""
        return self.rig.name

    @property
    def made_of(self) -> str:
        """Fingerprint of all that its row depends on; recordings by size and time of change."""
        paths = (*self.rig.train, *self.rig.test)
        files = [(p.name, (s := p.stat()).st_size, s.st_mtime_ns) if p.exists() else p.name for p in paths]
        config = self.config if isinstance(self.config, str) else self.config.model_dump_json(exclude={"model"})
        facts = (KIND, config, self.work, self.seed, self.model.stem if self.model is not None else "", files)
        return hashlib.sha256(repr(facts).encode()).hexdigest()[:16]


def attempt(task: RigTask) -> Row:
    """Work on a rig; one that cannot be fitted is a row with its reason.

    The rig's own core is the only one that it uses. Its simulations run in a process of their own that can be killed.
    """
    config, folder, fmu = task.config, task.out / RUNS / task.rig.name, task.model
    if isinstance(config, str):
        return failure(task.key, config)
    assert fmu is not None
    if hashlib.sha256(fmu.read_bytes()).hexdigest() != fmu.stem:
        return failure(task.key, f"{fmu}: has changed since the fleet was started")
    built: Path | None = fmu
    if config.model.fmu is not None:
        config, built = config.model_copy(update={"model": config.model.model_copy(update={"fmu": fmu})}), None
    # Rigs of one model share the extended models that their loops export.
    cache = fmu.parent / "loop"
    options = RunOptions(folder, config=config, seed=task.seed, workers=1, quiet=True, built=built, cache=cache)
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with (
            (folder / LOG).open("w", encoding="utf-8") as log,
            contextlib.redirect_stdout(log),
            contextlib.redirect_stderr(log),
        ):
            _COMMANDS[task.work](task.rig, options)
    except (InputError, CannotFinishError) as error:
        return failure(task.key, str(error))
    searched = {item.name: item for item in fit_parameters(Model.load(fmu), config)}
    return _row(task.key, RunDirectory.read(folder).result, searched)


def _row(name: str, result: RunJson, searched: Mapping[str, Parameter]) -> Row:
    """Make the row of a finished rig: the numbers of its ``result.json`` that the fleet needs."""
    loop, words = result.loop, result.effect_words()
    effects = loop.effects if loop else []
    wanted = {*searched, *(key for effect in effects for key in effect.parameters)}
    ratios = [one.ratio for outputs in result.residual.values() for one in outputs.values() if one.ratio is not None]
    return {
        "key": name,
        "simulated": result.simulated,
        "parameters": {
            key: _parameter(entry, searched.get(key))
            for key, entry in result.parameters.items()
            if key in wanted and entry.status != "fixed" and entry.value is not None
        },
        "over_floor": max(ratios, default=None),
        "outcome": loop.outcome if loop else "",
        "effects": [_named(effect, loop, words) for effect in effects] if loop else [],
    }


def _parameter(entry: ParameterJson, item: Parameter | None) -> dict[str, Any]:
    stated = {"value": entry.value, "unit": entry.unit}
    low, middle, high = entry.q05, entry.q50, entry.q95
    if low is None or middle is None or high is None or not high > low:
        return stated
    floor = item.lower if item is not None else entry.lower
    log = low > 0.0 and floor is not None and floor >= 0.0
    if log:
        low, middle, high = math.log(low), math.log(middle), math.log(high)
    likelihood = _without_prior(middle, (high - low) / (2.0 * NORMAL_HALF_WIDTH), item, log=log)
    return stated | {"log": log, "centre": likelihood[0], "width": likelihood[1]} if likelihood else stated


def _without_prior(centre: float, sd: float, item: Parameter | None, *, log: bool) -> tuple[float, float] | None:
    """Compute centre and width of the likelihood: a Gaussian posterior over the prior's own curvature.

    The fleet takes the place of the rig's prior; with both it would be counted once a rig. None if little is left."""
    if item is None:
        return centre, sd
    value = min(max(math.exp(centre) if log else centre, item.lower), item.upper)
    first, second = item.prior.derivatives(np.array([value]))
    slope, bend = float(first[0]), float(second[0])
    if log:
        slope, bend = slope * value + 1.0, bend * value**2 + slope * value
    precision = 1.0 / sd**2 + bend
    return (centre - slope / precision, precision**-0.5) if precision >= MIN_LIKELIHOOD_SHARE / sd**2 else None


def _named(effect: EffectJson, loop: LoopJson, words: Mapping[str, str]) -> dict[str, Any]:
    """Describe an effect that the loop named, and those that its data cannot tell from it."""
    alike = next((group for group in loop.equivalent if effect.id in group), [])
    return {"id": effect.id, "summary": words.get(effect.id, ""), "alike": [i for i in alike if i != effect.id]}
