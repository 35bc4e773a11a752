"""The page of a run: one HTML file that needs nothing but itself."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup

from aero_bayes.files import whole_file
from aero_bayes.report import (
    experiment,
    findings,
    loop_figures,
    loop_story,
    overview,
    posterior_figures,
    profile_figures,
    residual_figures,
    series_figures,
)
from aero_bayes.report.drawing import Plate
from aero_bayes.report.effect_names import named_effect
from aero_bayes.report.run_directory import RunDirectory, mapping, table, texts
from aero_bayes.report.sensor_table import sensor_table
from aero_bayes.report.tables import generic_cell, parameter_table
from aero_bayes.report.text import role_words, sentence, symbol

_TITLES = {
    "fit": "Fit", "posterior": "Posterior", "close-loop": "Closed loop", "replay": "The paper, replayed",
    "design": "The next experiment",
}  # fmt: skip


@dataclass(frozen=True)
class RecordingPlates:
    """Everything drawn of one recording."""

    name: str
    role: str
    fit: Plate | None
    jumps: list[Plate]
    residual: Plate | None
    statistics: list[Plate]


def write_report(directory: Path | str) -> Path:
    """Draw ``DIR/report.html`` from the run's ``result.json``, ``series.npz`` and ``posterior.nc``.

    Parameters
    ----------
    directory : path
        What a command wrote with ``--out``. Only ``result.json`` must be there; the page shows what there is.

    Returns
    -------
    Path
        The page: a single file that loads nothing from elsewhere.

    Raises
    ------
    InputError
        No ``result.json`` in the directory, or one of the files is damaged.
    """
    run = RunDirectory.read(directory)
    target = run.path / "report.html"
    page = render(run)
    with whole_file(target) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return target


def render(run: RunDirectory) -> str:
    """The page's text. The same run always gives the same page."""
    return _template().render(_context(run))


@cache
def _template() -> Template:
    """The compiled template; compiling takes longer than drawing a small page."""
    environment = Environment(
        loader=PackageLoader("aero_bayes.report"), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.filters |= {"sentence": sentence, "symbol": symbol, "cell": generic_cell, "effect": named_effect}
    return environment.get_template("page.html.jinja")


def _context(run: RunDirectory) -> dict[str, Any]:
    result = run.result
    verdict, level = overview.verdict(run)
    command = str(result.get("command", ""))
    model = mapping(result, "model")
    parameters = mapping(result, "parameters")
    return {
        "title": str(result.get("title") or f"{_TITLES.get(command, 'Run')}: {model.get('name', run.path.name)}"),
        "kicker": " · ".join(filter(None, ("aero-bayes", command, str(model.get("name") or "")))),
        "verdict": verdict, "level": level, "simulated": result.get("simulated") is True,
        "warnings": overview.warnings(run), "readings": overview.readings(run),
        "parameters": parameter_table(parameters) if parameters else None,
        "identifiability": _identifiability(run),
        "recordings": [_recording(run, name) for name in run.recordings()],
        "residuals": findings.residual_table(run), "noise": findings.noise_table(run),
        "sensors": sensor_table(run),
        "rms": findings.rms_table(run), "fit_facts": findings.fit_facts(run), "pso": _pso(run),
        "prediction": _prediction(run), "posterior": _posterior(run),
        "loop": _loop(run) if mapping(result, "loop") else None,
        "replay": _replay(run), "design": experiment.experiment(run), "provenance": overview.provenance(run),
    }  # fmt: skip


def _recording(run: RunDirectory, name: str) -> RecordingPlates:
    roles = {str(row.get("name")): str(row.get("role", "")) for row in table(run.result, "recordings")}
    return RecordingPlates(
        name, role_words(roles.get(name, "")), series_figures.measured_against_fitted(run, name),
        series_figures.after_jumps(run, name), residual_figures.over_time(run, name),
        residual_figures.statistics(run, name),
    )  # fmt: skip


def _identifiability(run: RunDirectory) -> dict[str, Any]:
    found = mapping(run.result, "identifiability")
    return {
        "unidentified": texts(found, "unidentified"), "text": texts(found, "text"),
        "combinations": _unless_single(table(found, "combinations")),
        "profiles": profile_figures.profile_plates(run), "skipped": texts(found, "not_profiled"),
    }  # fmt: skip


def _unless_single(combinations: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Combinations but for those that are a parameter by itself: that one has a row in the table."""
    return [entry for entry in combinations if entry.get("text") not in texts(entry, "members")]


def _prediction(run: RunDirectory) -> dict[str, Any] | None:
    shown = {"recordings": findings.left_out_table(run), "stretches": findings.stretches_table(run)}
    note = mapping(run.result, "prediction").get("note")
    return shown | {"note": note} if any(shown.values()) else None


def _pso(run: RunDirectory) -> Plate | None:
    history = mapping(run.result, "fit", "pso").get("history")
    return posterior_figures.history_plate(history, "best cost") if isinstance(history, list) else None


def _posterior(run: RunDirectory) -> dict[str, Any] | None:
    parameters = mapping(run.result, "parameters")
    units = {name: str(mapping(entry).get("unit") or "") for name, entry in parameters.items()}
    status = {name: mapping(entry).get("status") for name, entry in parameters.items()}
    seen = {name: draws for name, draws in run.posterior.items() if status.get(name) != "unidentified"}
    shown = {
        "facts": findings.sampler_facts(run), "table": findings.sampler_table(run),
        "pairs": posterior_figures.pair_plate(seen, units) if seen else None,
        "traces": posterior_figures.trace_plates(run.posterior, units),
        "ensembles": max((len(draws) for draws in run.posterior.values()), default=0),
    }  # fmt: skip
    return shown if any(shown.values()) else None


def _loop(run: RunDirectory) -> dict[str, Any]:
    drawn = [(name, loop_figures.before_and_after(run, name)) for name in run.recordings()]
    return {
        "outcome": loop_story.outcome(run), "story": loop_story.story(run), "effects": loop_story.effects(run),
        "rounds": loop_story.rounds(run), "errors": loop_story.error_table(run), "shift": loop_story.shift_table(run),
        "equivalents": loop_story.equivalents(run), "separate": texts(run.result, "loop", "separate"),
        "diff": loop_story.diff_lines(run),
        "source": mapping(run.result, "loop").get("modelica_source"),
        "ports": [plate for name in run.recordings() for plate in loop_figures.port_plates(run, name)],
        "before": [
            (name, residual_figures.over_time(run, name, "before")) for name in run.recordings()
            if run.signals("before", name)
        ],
        "residuals": [(name, plate) for name, plate in drawn if plate],
    }  # fmt: skip


def _replay(run: RunDirectory) -> dict[str, Any] | None:
    shown = {
        "table": findings.replay_table(run), "figure": loop_figures.replay_plate(run),
        "notes": [Markup(sentence(note)) for note in texts(run.result, "replay", "notes")],
    }  # fmt: skip
    return shown if any(shown.values()) else None
