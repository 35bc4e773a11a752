"""Describe the model in a result: its diagrams, its signals, and the settings of the run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from aero_bayes.export import modelica_root
from aero_bayes.language.sources import modelica_files
from aero_bayes.workflow.diagram import model_diagrams
from aero_bayes.workflow.job import Job

Json = dict[str, Any]


def context_part(job: Job, result: Mapping[str, Any]) -> Json:
    """Return ``diagrams``, ``signals``, ``words`` and ``settings`` of result.json.

    ``result`` is what was found so far: whether a loop extended the model, and the ids of effects that it names."""
    variables = (*job.model.inputs, *job.model.states, *job.model.outputs)
    return {
        "diagrams": [diagram.model_dump() for diagram in _diagrams(job, result.get("loop") or {})],
        "signals": {v.name: {"unit": v.unit, "description": v.description} for v in variables},
        "words": dict(result.get("words") or {}),
        "settings": job.config.model_dump(),
    }


def _diagrams(job: Job, loop: Mapping[str, Any]) -> list[Any]:
    files: list[Any] = []
    if job.modelica:
        written = [job.options.out / effect["modelica"] for effect in loop.get("effects", []) if effect.get("modelica")]
        files += modelica_files([modelica_root(), *job.config.model.sources, *dict.fromkeys(written)])
    ports = [str(effect["id"]).partition("@")[2] or str(effect["port"]) for effect in loop.get("effects", [])]
    # what acts between two names is marked at both
    ports = [name for port in ports for name in port.split("-")]
    base = str(loop.get("base") or job.name)
    return model_diagrams(base, files, extended=str(loop.get("model", "")), ports=ports)
