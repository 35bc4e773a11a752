"""One function a command: read everything, do the work, write the run directory, draw its page."""

from __future__ import annotations

import json
import os
import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import click
import numpy as np
from threadpoolctl import threadpool_limits

from aero_bayes.checkpoint import Checkpoint, write_arrays
from aero_bayes.commands.context import context_part, resumable
from aero_bayes.commands.job import (
    Job,
    RunOptions,
    built_model,
    layout_of,
    open_job,
    recordings_of,
    tell_findings,
    tell_inputs,
    tell_notes,
    which_model,
)
from aero_bayes.commands.stages import (
    extended_job,
    fit_settings,
    loop_part,
    loop_settings,
    profile_part,
    run_loop,
    sample_settings,
    with_chosen_values,
)
from aero_bayes.config import Config, ModelSection, load_config
from aero_bayes.data.mend import mend
from aero_bayes.data.recording import Recording
from aero_bayes.display import join_names, parameter_lines
from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.estimate.calibrated_model import CalibratedModel
from aero_bayes.estimate.crossvalidation import leave_one_recording_out
from aero_bayes.estimate.exports import ValueTrial, trials_sentence
from aero_bayes.estimate.fit import fit
from aero_bayes.estimate.initial_states import check_plausible, mended_recordings
from aero_bayes.estimate.residual_tests import check_residuals, reports_by_recording
from aero_bayes.estimate.result import Fit
from aero_bayes.estimate.stored_fit import store
from aero_bayes.loop.result import LoopResult
from aero_bayes.modelica.library import declaration_of
from aero_bayes.plain import plain
from aero_bayes.progress import ProgressBar
from aero_bayes.report import words
from aero_bayes.report.page import write_run_page
from aero_bayes.report.results import (
    Series,
    band_series,
    fitted_series,
    loop_series,
    measured_series,
    merge,
    only_measured,
    recording_row,
    state_series,
    unfitted_series,
    versions,
    write_result,
)
from aero_bayes.report.schema_run import SCHEMA, RunJson
from aero_bayes.simulation.engines import open_simulator
from aero_bayes.simulation.model import ModelicaSource

if TYPE_CHECKING:
    from aero_bayes.estimate.posterior import Posterior


Json = dict[str, Any]

#: Written beside the recordings of the simulated bench; its presence is how a page knows to say so.
LABEL = "simulated.json"


def prediction_part(job: Job, found: Fit, progress: ProgressBar) -> Json:
    """Return the ``prediction`` entry of result.json; nothing for a single recording, or where it is switched off."""
    limit = job.config.prediction.max_seconds
    if len(job.recordings) < 2 or limit == 0.0:
        return {}
    opener = partial(open_simulator, workers=job.options.workers)
    rng = np.random.default_rng([job.options.seed, 7])
    entry: Json = {}
    try:
        with threadpool_limits(limits=1, user_api="blas"):
            left_out = leave_one_recording_out(found, opener, rng, progress=progress, time_limit=limit)
            entry["recordings"] = {one.recording: one for one in left_out}
    except CannotFinishError as error:
        entry["note"] = f"not completed: {error}"
    missing = [r.name for r in job.recordings if r.name not in entry.get("recordings", {})]
    if missing and "note" not in entry:
        entry["note"] = f"{', '.join(missing)} not predicted: the time limit of {limit:g} s was reached"
    return {"prediction": entry}


def run_fit(files: Sequence[Path], options: RunOptions) -> RunJson:
    """Run ``aero-bayes fit``: PSO, then bounded local search; with ``options.posterior``, MCMC after them."""
    began, command = time.perf_counter(), "posterior" if options.posterior else "fit"
    job = open_job(files, options)
    with resumable(job, command) as checkpoint:
        with ProgressBar(options.quiet) as progress:
            found = fit_job(job, progress, checkpoint)
            checks = _checks(job, found, progress)
            posterior = _sample(job, found, progress, checkpoint) if options.posterior else None
        result, series = _with_posterior(fit_part(job, found), posterior)
        return _finish(job, command, began, [result, checks], series, found, _calibrated(job, found))


def run_close_loop(
    train: Sequence[Path], test: Sequence[Path], options: RunOptions, validation: Sequence[Path] = ()
) -> RunJson:
    """Run ``aero-bayes close-loop``: find the effect that the model lacks, and the error before and after."""
    began = time.perf_counter()
    job = open_job(train, options, tests=test, validation=validation, loop=True)
    with resumable(job, "close-loop") as checkpoint:
        values: Json = {}
        with ProgressBar(options.quiet) as progress:
            if job.values:
                found = fit_job(job, progress)
                job, values = with_chosen_values(job, found), {"fit": {"values": plain(found.trials)}}
            loop = run_loop(job, progress)
            posterior = _sample(job, loop.after, progress, checkpoint) if options.posterior else None
        result, series = _with_posterior(_loop_page_parts(job, loop), posterior)
        return _finish(job, "close-loop", began, [result, values], series, loop.after, loop.calibrated)


def run_all(files: Sequence[Path], tests: Sequence[Path], options: RunOptions) -> RunJson:
    """Run all stages on one page, as plain ``make`` does: fit, closed loop, posterior of the final model."""
    began = time.perf_counter()
    job = open_job(files, options, tests=tests)
    if job.modelica:
        loop_settings(job)
    with resumable(job, "all") as checkpoint:
        with ProgressBar(options.quiet) as progress:
            base = fit_job(job, progress, checkpoint)
            job = with_chosen_values(job, base)
            # With listed values the model of the job may be another class than that of the fit.
            loop = run_loop(job, progress, None if base.trials else base) if job.modelica else None
            final = extended_job(job, loop) if loop is not None else job
            found = base if final is job else fit_job(final, progress, checkpoint, again=True)
            checks = _checks(final, found, progress)
            posterior = _sample(final, found, progress, checkpoint)
        result, series = _with_posterior(fit_part(final, found), posterior)
        parts = [result, checks]
        if loop is not None:
            story = loop_part(job, loop)
            series = loop_series(loop) | measured_series((*job.validation, *job.tests)) | series
            parts.append({key: story[key] for key in ("loop", "words")})
        return _finish(final, "all", began, parts, series, found, _calibrated(final, found))


def run_check(files: Sequence[Path], config_path: Path | None, model_name: str | None = None) -> None:
    """Run ``aero-bayes check``: summarise every recording; all are read before the first is printed."""
    config = load_config(config_path)
    name, fmu = which_model(config, RunOptions(Path(), model_name, config_path))
    declared = declaration_of(name, config.model.sources)
    model = None if declared.systems else built_model(config, name, fmu)
    layout = layout_of(config, model.declared if model is not None else declared, model)
    recordings = recordings_of(config, files, layout)
    tell_notes(recordings)
    if model is not None:
        check_plausible(recordings, model)
        tell_inputs(model, recordings)
    found = (
        mended_recordings(recordings, model) if model is not None else [part for r in recordings for part in mend(r)]
    )
    tell_findings(found)
    click.echo("\n\n".join(str(recording.summary()) for recording in recordings))


def fit_job(job: Job, progress: ProgressBar, checkpoint: Checkpoint | None = None, *, again: bool = False) -> Fit:
    """Fit a job; ``again`` starts a local fit from the start values of recordings that were fitted before."""
    settings = fit_settings(job)
    if not job.parameters:
        known = sorted(v.name for v in job.model.parameters)
        raise InputError(
            f"model {job.model.name} declares no parameters to fit: name them, "
            f"e.g. [parameters.{next(iter(known), 'p')}] with free = true"
        )
    return fit(
        job.recordings,
        job.model,
        parameters=job.parameters,
        settings=replace(settings, method="local") if again else settings,
        seed=job.options.seed,
        workers=job.options.workers,
        progress=progress,
        checkpoint=checkpoint,
        explain=not again,
    )


def _sample(job: Job, found: Fit, progress: ProgressBar, checkpoint: Checkpoint) -> Posterior:
    from aero_bayes.estimate.sample import sample

    posterior = sample(
        found,
        settings=sample_settings(job),
        seed=job.options.seed,
        workers=job.options.workers,
        checkpoint=checkpoint,
        progress=progress,
    )
    posterior.save(job.options.out / "posterior.nc")
    return posterior


def _checks(job: Job, found: Fit, progress: ProgressBar) -> Json:
    """Compute profiles of doubtful parameters, and how well the recordings predict each other."""
    return merge(profile_part(job, found, progress), prediction_part(job, found, progress))


def preamble(job: Job, command: str) -> Json:
    """Return the keys that every result.json starts with."""
    recordings = (*job.recordings, *job.validation, *job.tests)
    units = {name: unit for recording in recordings for name, unit in recording.units.items()}
    return {
        "schema": SCHEMA,
        "command": command,
        "seed": job.options.seed,
        "versions": versions(),
        "data": [recording.to_dict() for recording in job.read or recordings],
        "simulated": any(_is_simulated(recording) for recording in recordings),
        "units": units,
        "model": {
            "name": job.name,
            "fmu_sha256": job.model.sha256,
            "exporter": "Modelica source" if job.modelica else "FMU given",
            "engine": job.config.solver.engine,
        },
        "recordings": [
            *(recording_row(recording, "train") for recording in job.recordings),
            *(recording_row(recording, "validation") for recording in job.validation),
            *(recording_row(recording, "test") for recording in job.tests),
        ],
    }


def _is_simulated(recording: Recording) -> bool:
    """Return whether the simulated bench wrote the recording, by the label beside its file.

    Nothing else of it is read."""
    if recording.path is None or not (label := recording.path.with_name(LABEL)).is_file():
        return False
    return recording.path.stem in json.loads(label.read_text("utf-8")).get("recordings", [])


def residual_table(fit: Fit, recordings: Sequence[Mapping[str, Any]]) -> Json:
    """Write residual reports of a fit by recording and output, with the noise floors of ``recordings``."""
    floors = {(r["name"], output): floor for r in recordings for output, floor in r["noise_floor"].items()}
    return reports_by_recording(check_residuals(fit.calibration, fit.series, fit.optimum, floors))


def fit_part(job: Job, found: Fit) -> tuple[Json, Series]:
    start = preamble(job, "fit")
    result = merge(start, found.to_dict(), {"residual": residual_table(found, start["recordings"])})
    for entry in result["recordings"]:
        entry["rms"] = dict(found.rms_by_recording.get(entry["name"], {}))
    used = [{r.name: r for r in found.calibration.data.recordings}.get(r.name, r) for r in job.recordings]
    series = measured_series(used) | unfitted_series(job.read or job.recordings, used)
    series |= fitted_series(found)
    names = [state.name for state in found.calibration.model.states]
    states = dict(zip(found.calibration.data.names, found.states, strict=False))
    return result, series | state_series(names, states)


def _loop_page_parts(job: Job, loop: LoopResult) -> tuple[Json, Series]:
    given = (*job.recordings, *job.validation, *job.tests)
    series = measured_series(given) | unfitted_series(job.read, given) | loop_series(loop)
    return merge(preamble(job, "close-loop"), loop_part(job, loop)), series


def _with_posterior(parts: tuple[Json, Series], posterior: Posterior | None) -> tuple[Json, Series]:
    """Return result and curves with what a posterior adds to them."""
    if posterior is None:
        return parts
    curves = band_series(posterior.calibration.data.names, posterior.fit.outputs, posterior.predictive)
    return merge(parts[0], posterior.to_dict()), parts[1] | curves


def _calibrated(job: Job, found: Fit) -> CalibratedModel | None:
    """Return the model with all values of a fit; none where it came as an FMU."""
    return found.calibrated if job.modelica else None


def _finish(
    job: Job,
    command: str,
    began: float,
    parts: Sequence[Json],
    series: Series,
    fit: Fit,
    calibrated: CalibratedModel | None,
) -> RunJson:
    """Write the run directory and print its place; then the fitted model for other tools. Return the result."""
    out = job.options.out
    result = merge(*parts, {"command": command, "seconds": time.perf_counter() - began})
    store(fit, out)
    page, told = write_page(job, result, series)
    verdict = words.verdict(told).text
    rows = words.checks_told(told, verdict)
    for line in (verdict, "", *parameter_lines(told.parameters), "", words.checks_line(told), *rows):
        click.echo(words.plain(line))
    if result.get("fit", {}).get("values"):
        click.echo(trials_sentence([ValueTrial(**row) for row in result["fit"]["values"]]))
    click.echo(f"wrote {out / 'result.json'} and {page}")
    named = calibrated.name.rpartition(".")[2] if calibrated is not None else f"{Path(job.name).stem}_fitted"
    script = re.sub(r"\W", "_", named)
    made = [fit.to_matlab(out / f"{script}.m")]
    if calibrated is not None:
        # what is written must compile: the FMU is made first
        try:
            fmu = calibrated.export_fmu(out / f"{calibrated.name}.fmu")
        except InputError as error:
            click.echo(f"note: no model with the fitted values is written: {error}", err=True)
        else:
            made[:0] = [calibrated.write(out), fmu]
    click.echo(f"wrote {join_names([str(path) for path in made])}: all fitted values, for other tools")
    return told


def write_page(job: Job, result: Json, series: Series) -> tuple[Path, RunJson]:
    """Write the files of a run and draw its page; return the page, and what it tells."""
    out = job.options.out
    # Result and page stand together or not at all, also where the disk is full: both are made beside, then moved.
    with TemporaryDirectory(dir=out, prefix=".run-") as beside:
        made = Path(beside)
        if (posterior := out / "posterior.nc").is_file():
            os.link(posterior, made / posterior.name)
        write_arrays(made / "series.npz", only_measured(series), compressed=True)
        document = plain(result | context_part(job, result))
        document.setdefault("verdict", words.verdict(RunJson.model_validate(document)).model_dump())
        told = write_result(made, document)
        page = write_run_page(made)
        for name in ("series.npz", "result.json", page.name):
            (made / name).replace(out / name)
    return out / page.name, told


def write_folder(found: Fit | Posterior | LoopResult, folder: Path) -> Path:
    """Write the folder of a fit, a posterior or a loop that no command made: what a command writes; return the page."""
    fit = found if isinstance(found, Fit) else found.before if isinstance(found, LoopResult) else found.fit
    calibration, model = fit.calibration, fit.calibration.model
    source = model.source or ModelicaSource(model.name)
    config = Config(model=ModelSection(sources=source.files, libraries=source.libraries))
    job = Job(
        RunOptions(folder), config, source.name, model.source is not None, model, calibration.data.recordings, (),
        calibration.parameters, dict(calibration.fixed),
    )  # fmt: skip
    folder.mkdir(parents=True, exist_ok=True)
    store(found if isinstance(found, Fit) else found.fit, folder)
    if isinstance(found, LoopResult):
        known = found.recordings
        job = replace(job, recordings=known.train, validation=known.validation, tests=known.test)
        if found.modelica_path:  # the diagram of the extended model is drawn from its file
            (folder / found.modelica_path).write_text(found.modelica, encoding="utf-8")
        result, series = _loop_page_parts(job, found)
    else:
        posterior = None if isinstance(found, Fit) else found
        result, series = _with_posterior(fit_part(job, fit), posterior)
        if posterior is not None:
            result["command"] = "posterior"
            posterior.save(folder / "posterior.nc")
    return write_page(job, result, series)[0]
