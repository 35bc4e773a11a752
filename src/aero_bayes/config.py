"""The typed configuration in a TOML file. Each error is one line that names the key."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, TypeVar, get_type_hints

from pydantic import BaseModel, ConfigDict, Field, PrivateAttr, ValidationError, create_model

from aero_bayes.arguments import NotNegative, Positive
from aero_bayes.data.columns import ColumnMap
from aero_bayes.errors import InputError
from aero_bayes.estimate.convergence import SampleSettings
from aero_bayes.estimate.initial_states import CalibrationSettings
from aero_bayes.estimate.levenberg_marquardt import FitSettings, Stage
from aero_bayes.estimate.swarm import SwarmSettings
from aero_bayes.loop.first_fit import LoopSettings
from aero_bayes.modelica.sources import as_packages
from aero_bayes.simulation.interface import SolverSettings
from aero_bayes.unknown_names import closest_name, no_such_file

Sections = TypeVar("Sections", bound=BaseModel)


class Section(BaseModel):
    """A table of the file. Unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def keys_of(settings: object, names: str) -> Callable[[type[Sections]], type[Sections]]:
    """Give a section the keys that are settings of these names: their types, limits and defaults are declared there.

    Of a class of settings in place of an object, keys without a default are required."""
    hints = get_type_hints(settings if isinstance(settings, type) else type(settings), include_extras=True)
    keys: Any = {name: (hints[name], getattr(settings, name, ...)) for name in names.split()}

    def with_keys(section: type[Sections]) -> type[Sections]:
        found: type[Sections] = create_model(
            section.__name__, __base__=section, __doc__=section.__doc__, __module__=section.__module__, **keys
        )
        return found

    return with_keys


class PriorSection(Section):
    """A prior such as ``{kind = "lognormal", median = 8.4, relative_sd = 0.15}``; numbers in the SI unit."""

    kind: Literal["uniform", "loguniform", "normal", "lognormal"]
    mean: float | None = None
    sd: Positive | None = None
    median: Positive | None = None
    relative_sd: Positive | None = None
    lower: float | None = None
    upper: float | None = None


class ParameterSection(Section):
    """``[parameters.R_a]``: whether it is fitted, from where, and within which bounds (SI units).

    ``value = {light = 1.0, heavy = 2.5}`` is known by recording. ``values`` are each fitted and compared, in place of a
    search."""

    free: bool | Literal["auto", "later"] | None = None
    value: float | dict[str, float] | None = None
    lower: float | None = None
    upper: float | None = None
    prior: PriorSection | None = None
    per_recording: bool = False
    values: tuple[bool | int | float | str, ...] | None = None


class ModelSection(Section):
    """``[model]``: a Modelica class (with extra source files and folders of libraries) or an FMU.

    ``units`` are those of variables of an FMU that declares none: ``units = {F = "N", v = "m/s"}``."""

    name: str | None = None
    fmu: Path | None = None
    sources: tuple[Path, ...] = ()
    libraries: tuple[Path, ...] = ()
    units: dict[str, str] = Field(default_factory=dict)


@keys_of(ColumnMap(""), "unit scale offset counts_per_revolution unwrap reset missing kind stamp")
class ColumnSection(Section):
    """``[data.columns.theta]``: where a signal stands in the file (else under its own name), and its unit there.

    ``unwrap`` takes the jumps of a turn out of an angle that is recorded modulo one turn; a number, those of a counter
    that rolls over at it. ``reset``: a counter that is reset goes on. ``missing`` are values in the
    file that stand for none: an output has a gap there, an input keeps the value before. ``kind = "mean"`` is the mean
    over the interval that ends at its time, or begins there: ``stamp``."""

    source: str | None = None


class DataSection(Section):
    """``[data]``: names of inputs and outputs (default: as declared, else the model's), and their columns.

    ``constants`` are inputs without a column; ``batch`` names the column that says which run a row of a table is of."""

    inputs: tuple[str, ...] | None = None
    outputs: tuple[str, ...] | None = None
    interpolation: Literal["auto", "hold", "linear"] | dict[str, Literal["hold", "linear"]] | None = None
    constants: dict[str, float] = Field(default_factory=dict)
    columns: dict[str, ColumnSection] = Field(default_factory=dict)
    batch: str | None = None


@keys_of(SwarmSettings(), "particles iterations tolerance")
class PsoSection(Section):
    """``[fit.pso]``: particle swarm."""


@keys_of(FitSettings(), "starts")
@keys_of(FitSettings().local, "iterations tolerance")
class LocalSection(Section):
    """``[fit.local]``: bounded trust-region search."""


@keys_of(Stage, "parameters outputs")
class StageSection(Section):
    """One entry of ``[[fit.stages]]``: these parameters from these outputs."""


@keys_of(FitSettings(), "cost method staged")
@keys_of(CalibrationSettings(), "initial_states max_input_delay")
class FitSection(Section):
    """``[fit]``: the cost, the search, and what else is estimated beside the parameters."""

    stages: tuple[StageSection, ...] | None = None
    pso: PsoSection = PsoSection()
    local: LocalSection = LocalSection()


class OutputNoiseSection(Section):
    """``[noise.T]``: the kind of noise that the output ``T`` has, or its standard deviation, also by recording."""

    kind: Literal["auto", "white", "relative", "student", "rounded"] = "auto"
    sd: Positive | dict[str, Positive] | None = None


class NoiseSection(Section):
    """``[noise]``: the noise of outputs, and process noise of states.

    ``[noise.T] kind = "relative"`` declares the noise of the output ``T``; by default the data choose."""

    process: dict[str, NotNegative | Literal["estimated"]] = Field(default_factory=dict)
    initial_sd: dict[str, NotNegative] = Field(default_factory=dict)

    model_config = ConfigDict(extra="allow", frozen=True)
    __pydantic_extra__: dict[str, OutputNoiseSection] = Field(init=False)

    @property
    def outputs(self) -> dict[str, OutputNoiseSection]:
        """What is declared of the noise of single outputs."""
        return self.__pydantic_extra__


@keys_of(SampleSettings(), "ensembles walkers max_steps max_minutes r_hat ess")
class PosteriorSection(Section):
    """``[posterior]``: when the sampler may stop."""


class PredictionSection(Section):
    """``[prediction]``: how well several recordings predict each other; ``max_seconds = 0`` leaves it out."""

    max_seconds: NotNegative = 10.0


@keys_of(LoopSettings(), "max_effects max_minutes held_out effects exclude require ports laws")
class LoopSection(Section):
    """``[loop]``: the search for the effect that the model lacks."""


@keys_of(SolverSettings(), "relative_tolerance absolute_tolerance time_limit")
class SolverSection(Section):
    """``[solver]``: engine and accuracy of a simulation."""

    engine: Literal["native"] = "native"  # there is one


class Config(Section):
    """The whole file; ``priors_from`` is the ``posterior.nc`` of an earlier experiment, the prior of this one."""

    model: ModelSection = ModelSection()
    data: DataSection = DataSection()
    parameters: dict[str, ParameterSection] = Field(default_factory=dict)
    fit: FitSection = FitSection()
    noise: NoiseSection = NoiseSection()
    posterior: PosteriorSection = PosteriorSection()
    prediction: PredictionSection = PredictionSection()
    loop: LoopSection = LoopSection()
    solver: SolverSection = SolverSection()
    priors_from: Path | None = None
    _file: Path | None = PrivateAttr(None)

    def place(self, name: str) -> str:
        """Return file and line at which a parameter is configured, for messages; empty if read from no file."""
        if self._file is None:
            return ""
        key = rf"""\s*(\[parameters\.|parameters\.)?["']?{re.escape(name)}["']?\s*[\].=]"""
        lines = self._file.read_text(encoding="utf-8").splitlines()
        found = next((f", line {k}" for k, line in enumerate(lines, 1) if re.match(key, line)), "")
        return f"{self._file}{found}: "


def load_config(path: Path | Config | None) -> Config:
    """Read a configuration."""
    if path is None or isinstance(path, Config):
        return path or Config()
    config = resolve_paths(validated(Config, read_toml(path), path), path.parent)
    config._file = path
    return config


def read_toml(path: Path) -> dict[str, Any]:
    """Return the content of a TOML file. Raises InputError if it cannot be read."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(no_such_file(path)) from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not valid TOML: {error}") from None


def validated(section: type[Sections], document: Any, where: object) -> Sections:
    """Return a document as a section. InputError, which starts with ``where``, for an unknown key or a wrong value."""
    try:
        return section.model_validate(document)
    except ValidationError as error:
        raise InputError(f"{where}: {_first_problem(error, section)}") from None


def resolve_paths(config: Config, folder: Path) -> Config:
    """Return the configuration with relative paths resolved from a folder."""
    model = config.model
    resolved = model.model_copy(
        update={
            "fmu": folder / model.fmu if model.fmu is not None else None,
            "sources": as_packages(folder / source for source in model.sources),
            "libraries": tuple(folder / library for library in model.libraries),
        }
    )
    prior = folder / config.priors_from if config.priors_from is not None else None
    return config.model_copy(update={"model": resolved, "priors_from": prior})


def _first_problem(error: ValidationError, whole: type[BaseModel]) -> str:
    problem = error.errors()[0]
    location = [str(part) for part in problem["loc"]]
    key = ".".join(location)
    if problem["type"] == "extra_forbidden":
        known = _known_keys(location[:-1], whole)
        close = closest_name(location[-1], known)
        hint = f"did you mean '{close}'?" if close is not None else f"known here: {', '.join(sorted(known))}"
        return f"key '{key}' does not exist; {hint}"
    return f"key '{key}': {problem['msg'][0].lower()}{problem['msg'][1:]}, got {problem['input']!r}"


def _known_keys(location: list[str], whole: type[BaseModel]) -> list[str]:
    """List the keys that exist at a location in the file, from the annotations of the sections."""
    section: type[BaseModel] | None = whole
    for part in location:
        if section is None or part not in section.model_fields:
            continue
        section = _section_of(section.model_fields[part].annotation)
    return list(section.model_fields) if section is not None else []


def _section_of(annotation: object) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for argument in getattr(annotation, "__args__", ()):
        if (found := _section_of(argument)) is not None:
            return found
    return None
