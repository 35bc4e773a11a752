"""The page of a run: one HTML file that needs nothing but itself."""

from __future__ import annotations

import base64
import hashlib
import json
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from aero_bayes.arrays import FloatArray
from aero_bayes.files import write_whole
from aero_bayes.loop.result import LoopJson
from aero_bayes.report import curves, experiment, finding, findings, fit_figures, loop_figures, pairs, words
from aero_bayes.report.diagram import diagram_plate
from aero_bayes.report.drawing import Plate
from aero_bayes.report.run_directory import RunDirectory
from aero_bayes.report.schema_run import RunJson
from aero_bayes.report.tables import parameter_table, prior_table, status_words
from aero_bayes.report.text import named_effect, sentence, tidy

#: Steps that a series' range is divided into, as a power of two: far below what a sensor resolves.
BITS = 18
_TIME_BITS = 22


def embedded(series: Mapping[str, FloatArray]) -> Markup:
    """Write all series as JSON, safe within a ``<script>`` element."""
    packed = {key: pack_series(values, _TIME_BITS if _increases(values) else BITS) for key, values in series.items()}
    return Markup(json.dumps(packed, separators=(",", ":")).replace("<", "\\u003c"))


def pack_series(values: FloatArray, bits: int = BITS) -> dict[str, object]:
    """Return a series as base64 of deflated byte planes of the differences between whole numbers.

    Zero stands for a gap."""
    size = len(values)
    known = np.isfinite(values)
    low, high = (float(np.min(values[known])), float(np.max(values[known]))) if known.any() else (0.0, 0.0)
    if size > 1 and known.all():
        spacing = (float(values[-1]) - float(values[0])) / (size - 1)
        if np.allclose(values, values[0] + spacing * np.arange(size), rtol=0, atol=1e-4 * abs(spacing)) and spacing:
            return {"n": size, "lo": float(values[0]), "step": spacing, "even": 1}
    step = (high - low) / 2**bits or 1.0
    whole = np.where(known, 1 + np.round((np.nan_to_num(values) - low) / step), 0).astype(np.int64)
    change = np.diff(whole, prepend=0)
    folded = np.where(change < 0, -2 * change - 1, 2 * change).astype(np.uint32)
    planes = np.concatenate([((folded >> shift) & 0xFF).astype(np.uint8) for shift in (0, 8, 16)])
    text = base64.b64encode(zlib.compress(planes.tobytes(), 9)).decode("ascii")
    return {"n": size, "lo": low, "step": step, "ends": [low, high], "d": text}


def _increases(values: FloatArray) -> bool:
    return len(values) > 1 and bool(np.all(np.diff(values) > 0))


SCRIPTS = ("data", "panel", "figure", "save", "start")


def write_run_page(directory: Path | str) -> Path:
    """Draw ``DIR/report.html`` from the run's ``result.json``, ``series.npz`` and ``posterior.nc``."""
    run = RunDirectory.read(directory)
    return write_whole(run.path / "report.html", render(run))


def render(run: RunDirectory) -> str:
    """Return the page's text. The same run always gives the same page."""
    return fill(_context(run), [run.result])


def fill(context: Mapping[str, Any], results: Sequence[RunJson]) -> str:
    """Return a page from the template; a context without a part has nothing to show there."""
    nothing = {"simulated": False, "verdicts": (), "warnings": (), "finding": (), "opening": ()}
    environment = _environment().overlay()
    words = {id_: text for result in results for id_, text in result.effect_words().items()}
    signals = {name for result in results for name in result.signals}
    environment.filters = environment.filters | {
        "sentence": partial(sentence, words=words, signals=signals), "terse": partial(sentence, signals=signals),
        "effect": partial(named_effect, words=words),
    }  # fmt: skip
    script = _script()
    series = {key: values for plate in _plates(context.values()) for key, values in plate.series.items()}
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return environment.get_template("page.html.jinja").render(
        nothing | {**context}, script=Markup(script), script_hash=digest, series=embedded(series)
    )


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("aero_bayes.report"), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    return environment


@cache
def _script() -> str:
    """Return the page's script: its parts in order, in one scope of their own."""
    folder = Path(__file__).with_name("script")
    parts = [folder.joinpath(f"{name}.js").read_text("utf-8") for name in SCRIPTS]
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


@dataclass(frozen=True)
class Parts:
    """Parts of a page under a heading: a section where it has an ``id``, else folded."""

    heading: Markup | str
    parts: list[Part]
    id: str = ""


#: A table or paragraph that is written, a sentence, a figure or several small ones, facts by name, a fold.
Part = Markup | str | Plate | Sequence[Plate] | Mapping[str, str] | Parts


def with_parts(*found: Parts) -> list[Parts]:
    """Return those that have something to show."""
    kept = [Parts(one.heading, [part for part in one.parts if part], one.id) for one in found]
    return [one for one in kept if one.parts]


def led(name: str, *parts: Part | None) -> list[Part]:
    """Return parts below the paragraph on them, which goes with them."""
    kept = [part for part in parts if part]
    return [_lead(words.LEADS[name]), *kept] if kept else []


def _lead(text: Markup | str) -> Markup:
    return Markup('<p class="lead">{}</p>').format(text)


def _context(run: RunDirectory) -> dict[str, Any]:
    result, scene = run.result, curves.opening_scene(run)
    head, verdict = finding.finding(result), result.verdict or words.verdict(result)
    opening: list[Part] = [*head.curves] if head else led("errors", findings.errors_table(result))
    if scene:
        title = Markup('<h2 class="small">{}</h2>').format(curves.stretch_words(run, scene))
        opening += [title, curves.scene_plate(run, scene)]
    if line := words.checks_line(result):
        opening.append(Markup('<p class="checks">{}</p>').format(line))
    if table := findings.checks_table(result, words.short_verdict(result)):
        opening.append(Markup('<div class="diagnosis">{}</div>').format(table))
    return {
        "title": words.title(result, run.path.name), "simulated": result.simulated,
        "finding": head.columns if head else (),
        "kicker": " · ".join(filter(None, ("aero-bayes", result.command, result.model.name))),
        "verdicts": [(verdict.level, words.LEVELS[verdict.level], words.short_verdict(result))],
        "warnings": finding.warnings(result), "opening": opening,
        "sections": with_parts(
            Parts("The next experiment", experiment.experiment(run), "design"),
            Parts("Parameters", _parameters(result), "parameters"),
            Parts("Measured and modelled", _recordings(run, scene), "fit"),
            Parts("Posterior", _posterior(run), "posterior"),
            Parts("Details", _details(run), "details"),
        ),
    }  # fmt: skip


def _parameters(result: RunJson) -> list[Part]:
    aside = {n: p for n, p in result.parameters.items() if p.status == "fixed" or p.recording}
    folded = "Values of single recordings, and fixed parameters"
    known, said = result.identifiability, words.short_verdict(result)
    unknown = ", ".join(f"`{name}`" for name in known.unidentified) if not known.text else ""
    shown = parameter_table({n: p for n, p in result.parameters.items() if n not in aside})
    return [
        *led("shift", findings.shifts_table(result)), *led("parameters", shown),
        *with_parts(Parts(folded, [parameter_table(aside, folded)])), status_words(result.parameters),
        findings.listed_values_table(result), *(line for line in known.text if line not in said),
        f"Not determined by these data: {unknown}." if unknown else "",
    ] if result.parameters else []  # fmt: skip


def _recordings(run: RunDirectory, scene: curves.Scene | None) -> list[Part]:
    """Return the figures of the recordings; those of a fitted one are folded where another one was not fitted."""
    names = run.recordings()
    shown: list[Part] = []
    unseen = any(run.unseen(name) is not None for name in names)
    for name in names:
        above = scene is not None and scene.recording == name and scene.stretch == run.span(name)
        drawn = curves.recording_plate(run, name, without=scene.output if scene and above else "")
        head = Markup('{} <span class="role">{}</span>').format(name, curves.role_of(run.result, name))
        if drawn and unseen and run.unseen(name) is None:
            shown += [Parts(head, [drawn])]
        elif drawn:
            shown += [Markup("<h3>{}</h3>").format(head), drawn]
    errors = led("errors", findings.errors_table(run.result)) if run.result.loop else []
    return [*errors, *led("curves", *shown)]


def _posterior(run: RunDirectory) -> list[Part]:
    parameters, mcmc = run.result.parameters, run.result.mcmc
    units = {name: entry.unit for name, entry in parameters.items()}
    dull = {name for name, entry in parameters.items() if entry.status == "unidentified"}
    seen = {name: draws for name, draws in run.posterior.items() if name not in dull}
    plot = pairs.pair_plate(seen, units) if seen else None
    drawn: list[Part] = [findings.sampler_facts(mcmc)] if mcmc else []
    if plot:
        title = "Parameters in pairs"
        drawn += [Parts(title, [plot])] if run.result.loop else [Markup("<h3>{}</h3>").format(title), plot]
    if mcmc:
        drawn += with_parts(Parts("Convergence of each parameter", [findings.sampler_table(mcmc)]))
    return led("posterior", *drawn)


def _details(run: RunDirectory) -> list[Part]:
    result, known = run.result, run.result.identifiability
    texts = {entry.text: entry.sd_relative for entry in known.combinations if entry.text not in entry.members}
    spread = "{}: to {} % (one standard deviation)"
    determined = [text if sd is None else spread.format(text, tidy(100 * sd)) for text, sd in texts.items()]
    untried = ", ".join(f"`{name}`" for name in known.not_profiled)
    heading = "Residuals of {}: autocorrelation and histogram"
    residuals = [Parts(heading.format(n), led("residuals", fit_figures.statistics(run, n))) for n in run.recordings()]
    left_out, note = findings.left_out_table(result), result.prediction.note
    return [*with_parts(
        *(_loop(result, result.loop) if result.loop else ()),
        Parts("Priors, bounds and combinations of parameters", [
            prior_table(result.parameters),
            Markup("<h3>Combinations that the data determine</h3>") if determined else "", *determined,
            Markup("<h3>Profile likelihoods</h3>") if known.profiles else "",
            *led("profiles", fit_figures.profile_plates(run)),
            f"Not profiled, because the time limit was reached: {untried}." if untried else "",
        ]),
        *residuals,
        Parts("Noise and sensors", [
            *led("noise", findings.noise_model_table(result)),
            *led("process_noise", findings.process_noise_table(result)), findings.sensor_table(result),
        ]),
        Parts("Prediction of what was left out", led("prediction", left_out, note) if left_out else []),
        Parts("Diagram of the model", [drawn for one in result.diagrams if (drawn := diagram_plate(one))]),
        Parts("Optimisation", [
            findings.fit_facts(result), fit_figures.waterfall_plates(result.fit.start_levels),
        ]),
        Parts("Data, model, versions", [
            Markup('<div class="tables">{}</div>').format(Markup("").join(finding.provenance(result))),
        ]),
    )]  # fmt: skip


def _loop(result: RunJson, loop: LoopJson) -> list[Parts]:
    """Return what a loop tried, and what it added."""
    table = loop_figures.rounds_table(loop, result.effect_words())
    return [
        Parts("What was tried", [*loop.story, *led("candidates", table)]),
        Parts("What was added to the Modelica model", [loop_figures.diff_text(loop)] if loop.diff else []),
    ]
