"""The page of a run: one HTML file that needs nothing but itself."""

from __future__ import annotations

import base64
import hashlib
import json
import math
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from aero_bayes.arrays import FloatArray
from aero_bayes.files import write_whole
from aero_bayes.report import (
    curves,
    experiment,
    finding,
    findings,
    fit_figures,
    loop_figures,
    overview,
    posterior_figures,
    words,
)
from aero_bayes.report.drawing import Plate
from aero_bayes.report.run_directory import RunDirectory
from aero_bayes.report.schema_estimate import ComponentJson, DiagramJson, ShapeJson
from aero_bayes.report.schema_run import LoopJson, RunJson
from aero_bayes.report.svg import ACCENT, INK, MUTED, WARM_COLOUR, Canvas
from aero_bayes.report.tables import Column, generic_cell, html_table, parameter_table, prior_table, status_words
from aero_bayes.report.text import greek_name, named_effect, pretty_unit, sentence, significant, symbol, tidy

_WIDTH, _MOST_HIGH, _MARGIN = 440.0, 460.0, 26.0
_LETTER = 5.6

Place = Callable[[float, float], tuple[float, float]]


def diagram_plate(diagram: DiagramJson) -> Plate | None:
    """Return a diagram as a figure; None for an empty one."""
    if not diagram.components:
        return None
    marked = [c for c in diagram.components if c.marked]
    alt = f"Diagram of {diagram.title}: {', '.join(c.name for c in diagram.components)}."
    if marked:
        alt += f" An effect was added at {' and '.join(c.name for c in marked)}."
    canvas, place, scale = _paper(diagram, alt)
    by_name = {c.name: c for c in diagram.components}
    for line in diagram.connections:
        points = line.points or _line_between(by_name[line.first], by_name[line.second])
        at = np.array([place(x, y) for x, y in points])
        canvas.curve(at[:, 0], at[:, 1], MUTED, 0.9 if line.signal else 1.4, "3 3" if line.signal else "")
    for component in diagram.components:
        _draw(canvas, component, place, scale)
    rows = [
        (c.name, c.description or c.type.rpartition(".")[2], ", ".join(_neighbours(diagram, c.name)),
         "effect added here" if c.marked else "")
        for c in diagram.components
    ]  # fmt: skip
    caption = Markup("<strong>{}</strong>. {}").format(
        diagram.title,
        f"Marked: the place where {'an effect was' if len(marked) == 1 else 'effects were'} added." if marked else "",
    )
    table = html_table(("part", "what it is", "connected to", ""), rows, alt)
    return Plate(canvas.svg(), alt, caption, table=table)


def _neighbours(diagram: DiagramJson, name: str) -> list[str]:
    ends = [(line.first, line.second) for line in diagram.connections]
    return list(dict.fromkeys(b if a == name else a for a, b in ends if name in (a, b)))


def _paper(diagram: DiagramJson, alt: str) -> tuple[Canvas, Place, float]:
    """Return a canvas that holds all components and lines, and where diagram coordinates go on it."""
    corners = [(x, y) for c in diagram.components for x, y in (c.extent[:2], c.extent[2:])]
    corners += [point for line in diagram.connections for point in line.points]
    xs, ys = zip(*corners, strict=True)
    across, up = max(max(xs) - min(xs), 60.0), max(max(ys) - min(ys), 20.0)
    scale = min((_WIDTH - 2 * _MARGIN) / across, (_MOST_HIGH - 2 * _MARGIN) / up, 2.6)
    left = 0.5 * (_WIDTH - scale * (min(xs) + max(xs)))

    def place(x: float, y: float) -> tuple[float, float]:
        return left + scale * x, _MARGIN - 6 + scale * (max(ys) - y)

    return Canvas(_WIDTH, scale * up + 2 * _MARGIN + 4, alt), place, scale


def _draw(canvas: Canvas, component: ComponentJson, place: Place, scale: float) -> None:
    x1, y1, x2, y2 = component.extent
    (left, top), (right, foot) = place(min(x1, x2), max(y1, y2)), place(max(x1, x2), min(y1, y2))
    middle = 0.5 * (left + right)
    if component.terminal == "connector":
        middle, y = 0.5 * (left + right), 0.5 * (top + foot)
        canvas.dots(np.array([middle]), np.array([y]), MUTED, 6.0, 1.0)
        foot, top = y + 4, y - 4
    elif component.terminal:
        side = min(5.0, 0.4 * (right - left))
        y = 0.5 * (top + foot)
        arrow = f"M{middle - side:.1f} {y - side:.1f}L{middle + side:.1f} {y:.1f}L{middle - side:.1f} {y + side:.1f}Z"
        canvas.shape(arrow, f"fill:var(--{ACCENT})")
        foot, top = y + side, y - side
    else:
        angle = math.radians(component.rotation)
        turn = math.cos(angle), math.sin(angle)

        def icon(x: float, y: float) -> tuple[float, float]:
            u, v = 0.005 * x * (x2 - x1), 0.005 * y * (y2 - y1)
            return place(0.5 * (x1 + x2) + turn[0] * u - turn[1] * v, 0.5 * (y1 + y2) + turn[1] * u + turn[0] * v)

        drawn = component.shapes or [ShapeJson(kind="rectangle", points=[(-100, -100), (100, 100)], filled=True)]
        for shape in drawn:
            outline = "".join(f"{'L' if k else 'M'}{x:.1f} {y:.1f}" for k, (x, y) in enumerate(_outline(shape, icon)))
            fill = "var(--panel)" if shape.filled else "none"
            colour = WARM_COLOUR if component.marked else INK
            end = "" if shape.kind == "line" else "Z"
            canvas.shape(outline + end, f"fill:{fill};stroke:var(--{colour});stroke-width:1.1")
    if component.marked:
        frame = f"M{left - 5:.1f} {top - 5:.1f}H{right + 5:.1f}V{foot + 5:.1f}H{left - 5:.1f}Z"
        canvas.shape(frame, f"fill:var(--{WARM_COLOUR});fill-opacity:.12;stroke:var(--{WARM_COLOUR});stroke-width:2")
        foot += 5
    room = max(2.2 * (right - left), 46.0)
    name = greek_name(component.name)
    size = max(8.5, min(11.0, 11.0 * room / (_LETTER * len(name))))
    canvas.text(middle, foot + 11, name, WARM_COLOUR if component.marked else MUTED, size, "middle")


def _outline(shape: ShapeJson, icon: Place) -> Iterator[tuple[float, float]]:
    (x1, y1), (x2, y2) = shape.points[0], shape.points[-1]
    if shape.kind == "rectangle":
        points = [(x1, y1), (x2, y1), (x2, y2), (x1, y2)]
    elif shape.kind == "ellipse":
        turns = np.linspace(0, 2 * math.pi, 24, endpoint=False)
        points = [(0.5 * (x1 + x2 + (x2 - x1) * math.cos(a)), 0.5 * (y1 + y2 + (y2 - y1) * math.sin(a))) for a in turns]
    else:
        points = shape.points
    return (icon(x, y) for x, y in points)


def _line_between(first: ComponentJson, second: ComponentJson) -> list[tuple[float, float]]:
    """Lead a line from the nearer side of one component to that of another, with one step between."""
    (a, b), (c, d) = _centre(first), _centre(second)
    half = [0.5 * abs(item.extent[2] - item.extent[0]) for item in (first, second)]
    if abs(c - a) <= half[0] + half[1]:  # one above the other
        tall = [0.5 * abs(item.extent[3] - item.extent[1]) for item in (first, second)]
        sign = math.copysign(1.0, d - b)
        return [(a, b + sign * tall[0]), (a, 0.5 * (b + d)), (c, 0.5 * (b + d)), (c, d - sign * tall[1])]
    sign = math.copysign(1.0, c - a)
    start, stop = a + sign * half[0], c - sign * half[1]
    knee = stop - sign * min(6.0, 0.5 * abs(stop - start))
    return [(start, b), (knee, b), (knee, d), (stop, d)]


def _centre(component: ComponentJson) -> tuple[float, float]:
    x1, y1, x2, y2 = component.extent
    return 0.5 * (x1 + x2), 0.5 * (y1 + y2)


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


def sensor_table(run: RunDirectory) -> Markup | None:
    """Write the count of encoders, and what rounding to it adds to the residual; by output."""
    rows = [
        (symbol(output), significant(found.encoder.step), pretty_unit(run.result.unit(output)),
         f"rounding is {tidy(100.0 * found.encoder.share, 2)} % of the residual's variance")
        for output, found in run.result.sensors.items()
        if found.encoder is not None
    ]  # fmt: skip
    if not rows:
        return None
    return html_table(("output", Column("one count", "right"), "unit", "effect on the noise"), rows, "Encoders")


SCRIPTS = ("data", "panel", "figure", "save", "start")


def write_run_page(directory: Path | str) -> Path:
    """Draw ``DIR/report.html`` from the run's ``result.json``, ``series.npz`` and ``posterior.nc``."""
    run = RunDirectory.read(directory)
    return write_whole(run.path / "report.html", render(run))


def render(run: RunDirectory) -> str:
    """Return the page's text. The same run always gives the same page."""
    return fill("page.html.jinja", _context(run), [run.result])


def fill(
    template: str, context: Mapping[str, Any], results: Sequence[RunJson], scripts: Sequence[str] = SCRIPTS
) -> str:
    """Return a page from its template."""
    environment = _environment().overlay()
    words = {id_: text for result in results for id_, text in result.effect_words().items()}
    signals = {name for result in results for name in result.signals}
    environment.filters = environment.filters | {
        "sentence": partial(sentence, words=words, signals=signals), "terse": partial(sentence, signals=signals),
        "effect": partial(named_effect, words=words),
    }  # fmt: skip
    script = _script(tuple(scripts))
    series = {key: values for plate in _plates(context.values()) for key, values in plate.series.items()}
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return environment.get_template(template).render(
        context, script=Markup(script), script_hash=digest, series=embedded(series)
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
    scene = curves.opening_scene(run)
    head, verdict = finding.finding(result), result.verdict or words.verdict(result)
    aside = {n: p for n, p in result.parameters.items() if p.status == "fixed" or p.recording}
    plates = [diagram_plate(d) for d in result.diagrams]
    return {
        "title": words.title(result, run.path.name), "leads": words.LEADS,
        "kicker": " · ".join(filter(None, ("aero-bayes", result.command, result.model.name))),
        "verdict": verdict, "said": words.short_verdict(result),
        "simulated": result.simulated, "finding": head,
        "opening": curves.scene_plate(run, scene) if scene else None,
        "opening_words": curves.stretch_words(run, scene) if scene else "",
        "diagrams": [plate for plate in plates if plate],
        "warnings": overview.warnings(result), "readings": overview.readings(result),
        "checks": words.checks_line(result), "diagnosis": findings.checks_table(result, verdict.text),
        "moved": findings.shifts_table(result),
        "parameters": parameter_table({n: p for n, p in result.parameters.items() if n not in aside}),
        "aside": parameter_table(aside, "Values of single recordings, and fixed parameters"),
        "priors": prior_table(result.parameters),
        "listed_values": findings.listed_values_table(run),
        "statuses": status_words(result.parameters), "identifiability": result.identifiability,
        "profiles": fit_figures.profile_plates(run),
        "combinations": [c for c in result.identifiability.combinations if c.text not in c.members],
        "recordings": [_recording(run, name, scene) for name in run.recordings()],
        "errors": findings.errors_table(result), "noise": findings.noise_model_table(run),
        "process_noise": findings.process_noise_table(run),
        "sensors": sensor_table(run), "fit_facts": findings.fit_facts(run),
        "prediction": _prediction(run), "posterior": _posterior(run),
        "waterfall": posterior_figures.waterfall_plate(result.fit.start_levels),
        "loop": _loop(run, result.loop) if result.loop else None,
        "design": experiment.experiment(run), "provenance": overview.provenance(result),
    }  # fmt: skip


def _recording(run: RunDirectory, name: str, scene: curves.Scene | None) -> dict[str, Any]:
    """Return the figures of a recording; those of a fitted one are folded where another one was not fitted."""
    above = scene.output if scene is not None and scene.recording == name else ""
    whole = scene is not None and scene.stretch == run.span(name)
    unseen = any(run.unseen(other) is not None for other in run.recordings())
    return {
        "name": name, "role": curves.role_of(run, name), "folded": unseen and run.unseen(name) is None,
        "curves": curves.recording_plate(run, name, without=above if whole else ""),
        "statistics": fit_figures.statistics(run, name),
    }  # fmt: skip


def _prediction(run: RunDirectory) -> dict[str, Any] | None:
    table = findings.left_out_table(run)
    return {"recordings": table, "note": run.result.prediction.note} if table else None


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
        "story": loop.story,
        "rounds": loop_figures.rounds_table(loop, run.result.effect_words()),
        "separate": loop.separate,
        "diff": loop_figures.diff_lines(loop),
    }
