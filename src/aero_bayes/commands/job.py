"""Read and check what a command works on: configuration, recordings and model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import click

from aero_bayes.config import Config, ParameterSection, PriorSection, load_config
from aero_bayes.data.columns import ColumnMap, Layout
from aero_bayes.data.read import read_recordings
from aero_bayes.data.recording import Recording
from aero_bayes.declared import PackageDeclaration
from aero_bayes.errors import InputError
from aero_bayes.estimate.calibrated_model import ListedValue, combinations
from aero_bayes.estimate.fit import declared_overrides
from aero_bayes.estimate.fittable import no_parameter_text
from aero_bayes.estimate.initial_states import check_plausible, mended_recordings
from aero_bayes.estimate.parameters import ParameterSet, ParameterSpec, parameters_from_model, with_joint_prior
from aero_bayes.estimate.priors import LogNormal, LogUniform, Normal, Prior, Uniform
from aero_bayes.files import one_run_at_a_time, write_whole
from aero_bayes.modelica.library import declaration_of
from aero_bayes.simulation.interface import SolverSettings
from aero_bayes.simulation.load_model import load_model, with_units
from aero_bayes.simulation.model import Model, ModelicaSource


@dataclass(frozen=True)
class RunOptions:
    """The options that every command which simulates a model shares.

    ``config`` is a file or what was read from one. ``built`` is the FMU of the class where somebody has built it
    already, ``cache`` a folder where the loop finds and leaves FMUs."""

    out: Path
    model: str | None = None
    config: Path | Config | None = None
    seed: int = 1
    workers: int | None = None
    resume: bool = False
    quiet: bool = False
    posterior: bool = False
    built: Path | None = None
    cache: Path | None = None


@dataclass(frozen=True)
class Job:
    """Everything that is known before the first simulation.

    ``name`` is the Modelica class, or the FMU's own model name; ``modelica`` says which of the two it came from.
    ``read`` are the recordings as they were read, before faults of theirs were mended and they were cut at gaps."""

    options: RunOptions
    config: Config
    name: str
    modelica: bool
    model: Model
    recordings: tuple[Recording, ...]
    tests: tuple[Recording, ...]
    parameters: ParameterSet
    fixed: dict[str, float]
    read: tuple[Recording, ...] = ()
    values: Mapping[str, tuple[ListedValue, ...]] = field(default_factory=dict)
    validation: tuple[Recording, ...] = ()

    @property
    def solver(self) -> SolverSettings:
        """Tolerances of every simulation in the job."""
        return SolverSettings(**self.config.solver.model_dump(exclude={"engine"}))


def without_units(model: Model) -> str:
    """Say that an FMU declares no unit of some signals, and what that excludes; empty where it declares all."""
    names = [v.name for v in (*model.inputs, *model.outputs, *model.states) if not v.unit]
    named = ", ".join(dict.fromkeys(names))
    what = "friction, drag and springs are tried only at a force in N or N.m that drives a speed in m/s or rad/s"
    return f"{model.path.name} declares no unit of {named}: {what}; give units in [model.units]" if named else ""


def open_job(
    files: Sequence[Path], options: RunOptions, *, tests: Sequence[Path] = (), validation: Sequence[Path] = (),
    loop: bool = False,
) -> Job:  # fmt: skip
    """Read the configuration and the recordings, then build or open the model; for a loop only one that it can extend.

    The output folder is made only once everything the user gave has been read."""
    _different(files)
    config = load_config(options.config)
    name, fmu = which_model(config, options)
    sources, libraries = config.model.sources, config.model.libraries
    declared = declaration_of(name, sources) if fmu is None else PackageDeclaration()
    model = Model.load(options.built) if options.built is not None else None
    if not declared.systems:
        # Nothing but the model itself says what its columns are.
        model = model or built_model(config, name, fmu)
        declared = model.declared
    if loop and model is not None and fmu is not None:
        if model.interface != "model exchange":
            raise InputError(f"{fmu}: the loop needs Model Exchange; this FMU has co-simulation only")
        if other := next((v.name for v in model.inputs if v.kind != "real"), None):
            raise InputError(f"{fmu}: the loop needs real inputs; {other} of this FMU is none: fit it")
        if without := without_units(model):
            click.echo(f"note: {without}", err=True)
    layout = layout_of(config, declared, model if not declared.systems or fmu is not None else None)
    recordings, confirming, test_recordings = (
        recordings_of(config, given, layout) for given in (files, validation, tests)
    )
    if fmu is None:
        built = options.out / f"{name.rpartition('.')[2]}.fmu"
        with one_run_at_a_time(options.out):
            if model is not None:
                write_whole(built, model.path.read_bytes())
                model = replace(Model.load(built), source=ModelicaSource(name, sources, libraries))
            else:
                model = load_model(name, sources=sources, libraries=libraries, folder=options.out)
    assert model is not None
    read = (*recordings, *confirming, *test_recordings)
    check_plausible(read, model)
    values = _listed(model, config)
    parameters = fit_parameters(model, config)
    fixed = _fixed(model, config, parameters)
    recordings, confirming, test_recordings = (
        mended_recordings(given, model) for given in (recordings, confirming, test_recordings)
    )
    tell_notes(read)
    tell_inputs(model, read)
    tell_findings((*recordings, *confirming, *test_recordings))
    options.out.mkdir(parents=True, exist_ok=True)
    return Job(
        options, config, name, fmu is None, model, recordings, test_recordings, parameters, fixed, read, values,
        confirming,
    )  # fmt: skip


def _different(files: Sequence[Path]) -> None:
    """Refuse recordings of the same name, since parameters of a recording are identified by it."""
    for k, path in enumerate(files):
        for other in files[:k]:
            if path.stem == other.stem:
                what = "given twice" if path.resolve() == other.resolve() else f"has the name of {other}"
                raise InputError(f"{path}: {what}; expected recordings of different names")


def built_model(config: Config, name: str, fmu: Path | None) -> Model:
    """Return the FMU, or one built from the class."""
    section = config.model
    return (
        Model.load(fmu) if fmu is not None else load_model(name, sources=section.sources, libraries=section.libraries)
    )


def which_model(config: Config, options: RunOptions) -> tuple[str, Path | None]:
    """Choose the Modelica class, or the path of the FMU; the command line wins over the file."""
    name, fmu, units = config.model.name, config.model.fmu, config.model.units
    if options.model is not None:
        name, fmu = (None, Path(options.model)) if options.model.endswith(".fmu") else (options.model, None)
    if fmu is None:
        if units:
            raise InputError(f"{options.config}: [model] units are those of an FMU; a Modelica class declares its own")
        if name is None:
            where = f"{options.config}: [model] names no model" if options.config else "no model"
            near = [f"--config {p}" for p in sorted(Path().glob("*.toml")) if p.name != "pyproject.toml"][:3]
            ways = " or ".join(["--model", *near]) if near else "--model, or in a file that aero-bayes init writes"
            raise InputError(f"{where}; name one by {ways}")
        return name, None
    if name is not None:
        raise InputError(f"{options.config}: [model] names both a class and an FMU; give one of them")
    return fmu.stem, with_units(fmu, units) if units else fmu


def layout_of(config: Config, declared: PackageDeclaration, model: Model | None = None) -> Layout:
    """Return the columns that the configuration names, else those that the package declares, else the model's own."""
    data = config.data
    return Layout.of(data.inputs, data.outputs, model=model, declared=declared, constants=data.constants)


def columns_of(config: Config) -> dict[str, ColumnMap]:
    return {
        name: ColumnMap(section.source or name, **section.model_dump(exclude={"source"}))
        for name, section in config.data.columns.items()
    }


def recordings_of(config: Config, files: Sequence[Path], layout: Layout) -> tuple[Recording, ...]:
    """Read the recordings, and note in each the values of parameters that the configuration gives by recording."""
    found = read_recordings(files, columns_of(config), layout=layout, batch=config.data.batch)
    for name, section in config.parameters.items():
        if isinstance(values := section.value, dict):
            for recording in found:
                if recording.name not in values:
                    raise InputError(
                        f"{config.place(name)}{name}: has no value for the recording {recording.name} "
                        f"(given for {', '.join(values)})"
                    )
            found = tuple(replace(r, known={**r.known, name: values[r.name]}) for r in found)
    return found


def tell_notes(recordings: Sequence[Recording]) -> None:
    """Print what of the files was not read, and how they were joined."""
    for note in dict.fromkeys(note for recording in recordings for note in recording.notes):
        click.echo(f"note: {note}", err=True)


def tell_inputs(model: Model, recordings: Sequence[Recording]) -> None:
    """Print what an FMU runs with besides what was recorded: its tool, and switches at their start values."""
    if model.execution_tool:
        tool = model.execution_tool
        click.echo(f"note: {model.path.name} says that it needs {tool} to run; where runs fail, install it here, or "
                   "export the model without", err=True)  # fmt: skip
    for v in model.inputs:
        if any(v.name not in recording.inputs for recording in recordings):
            click.echo(f"note: no column is named for the input {v.name}: it stays at {v.start:g}, where the FMU "
                       "starts it", err=True)  # fmt: skip


def tell_findings(recordings: Sequence[Recording]) -> None:
    """Print faults of readings."""
    for finding in dict.fromkeys(finding for recording in recordings for finding in recording.findings):
        click.echo(f"note: {finding.sentence}", err=True)


def fit_parameters(model: Model, config: Config) -> ParameterSet:
    """Free parameters: those that the package declares, changed by what the configuration says."""
    overrides = declared_overrides(model)
    known = {variable.name for variable in model.parameters}
    for name, section in config.parameters.items():
        if section.values is not None:
            overrides.pop(name, None)
            continue
        if name not in known:
            raise InputError(f"{config.place(name)}{no_parameter_text(model, name)}")
        held = section.free in (False, "later") or isinstance(section.value, dict)
        if isinstance(section.value, dict) and (section.free or section.per_recording):
            raise InputError(f"{config.place(name)}{name}: values known by recording are not fitted; leave free out")
        if section.per_recording and held:
            raise InputError(
                f"{config.place(name)}{name}: per_recording = true fits a value for each recording, and needs "
                "free = true; known ones are value = {NAME = 1.0, OTHER = 2.5}"
            )
        if held or (section.free is None and name not in overrides and section.value is not None):
            overrides.pop(name, None)
        else:
            try:
                overrides[name] = _override(name, section, overrides.get(name, ParameterSpec()))
                parameters_from_model(model, overrides={name: overrides[name]})
            except InputError as error:
                which = "" if name in str(error) else f"{name}: "
                raise InputError(f"{config.place(name)}{which}{error.configured}") from None
    parameters = parameters_from_model(model, overrides=overrides)
    if config.priors_from is None:
        return parameters
    own = [name for name, section in config.parameters.items() if section.prior is not None]
    return _after_experiment(config.priors_from, parameters, own)


def _after_experiment(path: Path, parameters: ParameterSet, own: Sequence[str]) -> ParameterSet:
    """Return the parameters with the posterior of an earlier experiment as prior, where they have none of their own."""
    from aero_bayes.estimate.posterior import draws_in

    try:
        return with_joint_prior(parameters, {name: d.ravel() for name, d in draws_in(path).items() if name not in own})
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _listed(model: Model, config: Config) -> dict[str, tuple[ListedValue, ...]]:
    """Return values of parameters that are listed in place of searched."""
    listed = {name: section.values for name, section in config.parameters.items() if section.values is not None}
    for name, values in listed.items():
        section = config.parameters[name]
        others = section.model_fields_set - {"values", *(["free"] if section.free is True else [])}
        if others:
            raise InputError(f"{config.place(name)}{name}: {min(others)} and values exclude each other; give one")
        try:
            combinations(model, {name: values})
        except InputError as error:
            raise InputError(f"{config.place(name)}{error.configured}") from None
    combinations(model, listed)
    return listed


def later_of(job: Job) -> ParameterSet:
    """Return parameters that are fixed until the loop has found an effect with which the data determine them."""
    sections = {name: section for name, section in job.config.parameters.items() if section.free == "later"}
    overrides = {name: _override(name, section, ParameterSpec()) for name, section in sections.items()}
    return parameters_from_model(job.model, overrides=overrides)


def _override(name: str, section: ParameterSection, default: ParameterSpec) -> ParameterSpec:
    return ParameterSpec(
        start=section.value if isinstance(section.value, float) else default.start,
        lower=section.lower if section.lower is not None else default.lower,
        upper=section.upper if section.upper is not None else default.upper,
        prior=_prior(name, section.prior) if section.prior is not None else default.prior,
        scale=default.scale if section.lower is None or section.lower > 0.0 else "linear",
        free_if_identified=section.free == "auto" if section.free is not None else default.free_if_identified,
        per_recording=section.per_recording or default.per_recording,
    )


def _prior(name: str, section: PriorSection) -> Prior:
    """Return a prior from its kind and the numbers that this kind needs."""
    if section.kind == "normal" and section.mean is not None and section.sd is not None:
        return Normal(section.mean, section.sd)
    if section.kind == "lognormal" and section.median is not None and section.relative_sd is not None:
        return LogNormal.tolerance(section.median, section.relative_sd)
    if section.kind in ("uniform", "loguniform") and section.lower is not None and section.upper is not None:
        family = Uniform if section.kind == "uniform" else LogUniform
        return family(section.lower, section.upper)
    needs = {"normal": "mean and sd", "lognormal": "median and relative_sd"}.get(section.kind, "lower and upper")
    raise InputError(f"parameters.{name}.prior: a {section.kind} prior needs {needs}")


def _fixed(model: Model, config: Config, parameters: ParameterSet) -> dict[str, float]:
    """Return values that the configuration gives to parameters that are not searched."""
    return {
        name: section.value
        for name, section in config.parameters.items()
        if isinstance(section.value, float) and name not in parameters
    }
