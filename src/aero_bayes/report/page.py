"""The page of a run: one HTML file that needs nothing but itself."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from aero_bayes.arrays import FloatArray
from aero_bayes.files import whole_file
from aero_bayes.report import (
    curves,
    experiment,
    findings,
    listed_values,
    loop_figures,
    loop_story,
    overview,
    posterior_figures,
    profile_figures,
    residual_figures,
    study,
)
from aero_bayes.report.diagram_figure import diagram_plate, is_all_equations
from aero_bayes.report.embed import embedded
from aero_bayes.report.figure import WIDE_WIDTH, Plate
from aero_bayes.report.run_directory import RunDirectory
from aero_bayes.report.sensor_table import sensor_table
from aero_bayes.report.tables import generic_cell, parameter_table, status_words
from aero_bayes.report.text import named_effect, sentence, symbol
from aero_bayes.schema import LoopJson, RunJson

_TITLES = {
    "fit": "Fit", "posterior": "Posterior", "close-loop": "Closed loop", "design": "The next experiment",
    "all": "From model to posterior",
}  # fmt: skip
SCRIPTS = ("data", "panel", "drawing", "figure", "pairs", "save", "start")
_OUTCOMES = {
    "adequate": "the model is adequate: the residual is noise",
    "extended": "the model was extended",
    "unexplained": "an effect is missing, and no candidate explains it",
}


@dataclass(frozen=True)
class RecordingPlates:
    """Everything drawn of one recording."""

    name: str
    role: str
    curves: Plate | None
    statistics: list[Plate]


def write_run_page(directory: Path | str) -> Path:
    """Draw ``DIR/report.html`` from the run's ``result.json``, ``series.npz`` and ``posterior.nc``."""
    run = RunDirectory.read(directory)
    target = run.path / "report.html"
    page = render(run)
    with whole_file(target) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return target


def render(run: RunDirectory) -> str:
    """Return the page's text. The same run always gives the same page."""
    context = _context(run)
    series = dict(run.series) | posterior_figures.drawn(run.posterior)
    return fill("page.html.jinja", context, series, [run.result])


def fill(
    template: str,
    context: Mapping[str, Any],
    series: Mapping[str, FloatArray],
    results: Sequence[RunJson],
    scripts: Sequence[str] = SCRIPTS,
) -> str:
    """Return a page from its template."""
    environment = _environment().overlay()
    words = {id_: text for result in results for id_, text in result.effect_words().items()}
    signals = {name for result in results for name in result.signals}
    environment.filters = environment.filters | {
        "sentence": partial(sentence, words=words, signals=signals), "effect": partial(named_effect, words=words)
    }  # fmt: skip
    script = _script(tuple(scripts))
    keys = sorted({key for plate in _plates(context.values()) for key in plate.keys})
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return environment.get_template(template).render(
        context, script=Markup(script), script_hash=digest, series=embedded({key: series[key] for key in keys})
    )


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("aero_bayes.report"), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.filters |= {"symbol": symbol, "cell": generic_cell}
    return environment


@cache
def _script(names: tuple[str, ...]) -> str:
    """Return a page's script: its parts in order, in one scope of their own."""
    folder = Path(__file__).with_name("script")
    parts = [folder.joinpath(f"{name}.js").read_text("utf-8") for name in names]
    return '"use strict";\n(() => {\n' + "\n".join(parts) + "})();"


def _plates(values: Iterable[Any]) -> Iterable[Plate]:
    """Yield all figures in nested containers."""
    for value in values:
        if isinstance(value, Plate):
            yield value
        elif isinstance(value, Mapping):
            yield from _plates(value.values())
        elif isinstance(value, list | tuple):
            yield from _plates(value)
        elif hasattr(value, "__dataclass_fields__"):
            yield from _plates(vars(value).values())


def _context(run: RunDirectory) -> dict[str, Any]:
    result = run.result
    model = (result.loop.base if result.loop else "") or result.model.name or run.path.name
    heading = result.study.title if result.study else _TITLES.get(result.command, "Run")
    scene = curves.opening_scene(run)
    equations = loop_story.changed_equations(result.loop) if result.loop else None
    plates = [diagram_plate(d) for d in result.diagrams if not (equations and is_all_equations(d))]
    diagrams = [plate for plate in plates if plate]
    return {
        "title": f"{heading}: {model}",
        "kicker": " · ".join(filter(None, ("aero-bayes", result.command, result.model.name))),
        "verdict": overview.stated_verdict(result), "simulated": result.simulated,
        "equations": equations, "new_values": loop_story.new_values(result.loop) if result.loop else "",
        "opening": curves.scene_plate(run, scene, 700 if diagrams else WIDE_WIDTH) if scene else None,
        "opening_words": curves.stretch_words(run, scene) if scene else "",
        "diagrams": diagrams,
        "warnings": overview.warnings(result), "readings": overview.readings(result),
        "diagnosis": findings.diagnosis_table(run),
        "parameters": parameter_table(result.parameters) if result.parameters else None,
        "listed_values": listed_values.listed_values_table(run),
        "statuses": status_words(result.parameters), "identifiability": result.identifiability,
        "profiles": profile_figures.profile_plates(run),
        "combinations": [c for c in result.identifiability.combinations if c.text not in c.members],
        "recordings": [_recording(run, name, scene) for name in run.recordings()],
        "curve_words": curves.MEANING,
        "residuals": findings.residual_floor_table(run), "noise": findings.noise_model_table(run),
        "process_noise": findings.process_noise_table(run),
        "sensors": sensor_table(run), "rms": findings.fit_error_table(run), "fit_facts": findings.fit_facts(run),
        "pso": posterior_figures.history_plate(result.fit.pso.history, "best cost") if result.fit.pso else None,
        "prediction": _prediction(run), "posterior": _posterior(run),
        "loop": _loop(run, result.loop) if result.loop else None,
        "study": _study(run), "design": experiment.experiment(run), "provenance": overview.provenance(result),
    }  # fmt: skip


def _recording(run: RunDirectory, name: str, scene: curves.Scene | None) -> RecordingPlates:
    above = scene.output if scene is not None and scene.recording == name and run.unseen(name) is not None else ""
    whole = scene is not None and scene.stretch == run.span(name)
    return RecordingPlates(
        name, curves.role_of(run, name), curves.recording_plate(run, name, without=above if whole else ""),
        residual_figures.statistics(run, name),
    )  # fmt: skip


def _prediction(run: RunDirectory) -> dict[str, Any] | None:
    shown = {"recordings": findings.left_out_table(run), "stretches": findings.stretches_table(run)}
    return shown | {"note": run.result.prediction.note} if any(shown.values()) else None


def _posterior(run: RunDirectory) -> dict[str, Any] | None:
    parameters, mcmc = run.result.parameters, run.result.mcmc
    units = {name: entry.unit for name, entry in parameters.items()}
    dull = {name for name, entry in parameters.items() if entry.status == "unidentified"}
    seen = {name: draws for name, draws in run.posterior.items() if name not in dull}
    shown = {
        "facts": findings.sampler_facts(mcmc) if mcmc else [], "table": findings.sampler_table(mcmc) if mcmc else None,
        "pairs": posterior_figures.pair_plate(seen, units) if seen else None,
        "traces": posterior_figures.trace_plates(run.posterior, units),
    }  # fmt: skip
    return shown if any(shown.values()) else None


def _loop(run: RunDirectory, loop: LoopJson) -> dict[str, Any]:
    return {
        "outcome": _OUTCOMES[loop.outcome], "story": loop.story,
        "effects": loop_story.effects(loop, run.result.parameters),
        "rounds": loop_figures.rounds_plates(loop, run.result.effect_words()),
        "errors": loop_story.before_after_table(run, loop), "shift": loop_story.shift_table(run, loop),
        "equivalents": loop.equivalent, "separate": loop.separate,
        "diff": loop_story.diff_lines(loop), "source": loop.modelica_source,
    }  # fmt: skip


def _study(run: RunDirectory) -> dict[str, Any] | None:
    found = run.result.study
    if found is None:
        return None
    return {
        "name": found.name, "title": found.title, "table": study.study_table(found),
        "figure": study.study_plate(run, found), "notes": [sentence(note) for note in found.notes],
    }  # fmt: skip
