"""Every key of the configuration changes what reaches the stages of the commands of its section."""

from __future__ import annotations

import json
import typing
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray
from pydantic import BaseModel

from aero_bayes.commands.job import Job, RunOptions, open_job
from aero_bayes.commands.stages import fit_settings, loop_settings, sample_settings
from aero_bayes.config import Config, load_config
from aero_bayes.laws.law_places import CandidateFilter
from aero_bayes.modelica.compilers import export_fmu

#: The commands that do what a section is about, of these three; others may be given the file and pass it over.
CONCERNS = {"posterior": ["posterior"], "prediction": ["fit", "posterior"], "loop": ["close-loop"]}
SOURCES = ["Rig.mo", "Lib.mo"]
BASE = {
    "model": {"name": "Rig", "sources": SOURCES},
    "data": {"inputs": ["u", "w"], "outputs": ["y", "z"]},
    "parameters": {"k": {"free": True}, "gain": {"free": True}},
}
STAGE = {"parameters": ["k"], "outputs": ["y"]}
#: Two values of each key, then what else has to be set; a table holds ``y``, ``gain`` or one stage in place of ``*``.
VALUES: Mapping[str, tuple[Any, ...]] = {
    "model.name": ("Rig", "Other"),
    "model.fmu": ("Rig.fmu", "Other.fmu", {"model": {}}),
    "model.units": ({"w": "V"}, {"w": "A"}, {"model": {"fmu": "Rig.fmu"}}),
    "model.sources": (SOURCES, ["Changed.mo", "Lib.mo"]),
    "model.libraries": (["one"], ["two"], {"model": {"name": "Rig", "sources": ["Rig.mo"]}}),
    "data.inputs": (["u"], ["u", "w"], {"data.constants": {"w": 0.5}}),
    "data.constants": ({"w": 0.5}, {"w": 1.0}, {"data": {"inputs": ["u"], "outputs": ["y", "z"]}}),
    "data.outputs": (["y"], ["y", "z"]),
    "data.batch": ("u", "w"),
    "priors_from": ("one.nc", "two.nc"),
    "data.interpolation": ("hold", "linear"),
    "data.columns.*.source": ("y", "z"),
    "data.columns.*.unit": ("rad", "deg", {"data.columns.y": {"source": "y"}}),
    "data.columns.*.scale": (1.0, 2.0, {"data.columns.y": {"source": "y"}}),
    "data.columns.*.offset": (0.0, 1.0, {"data.columns.y": {"source": "y"}}),
    "data.columns.*.counts_per_revolution": (1024, 2048, {"data.columns.y": {"source": "y", "unit": "count"}}),
    "data.columns.*.unwrap": (False, True, {"data.columns.y": {"source": "y", "scale": 100.0}}),
    "data.columns.*.reset": (False, True, {"data.columns.y": {"source": "y"}}),
    "data.columns.*.kind": ("instant", "mean", {"data.columns.y": {"source": "y"}}),
    "data.columns.*.stamp": ("end", "beginning", {"data.columns.y": {"source": "y", "kind": "mean"}}),
    "data.columns.*.missing": ([], [0.0], {"data.columns.y": {"source": "y"}}),
    "parameters.*.free": (True, False),
    "parameters.*.value": (1.0, 2.0),
    "parameters.*.values": ([1.0], [1.0, 2.0]),
    "parameters.*.per_recording": (False, True),
    "parameters.*.lower": (0.2, 0.3),
    "parameters.*.upper": (5.0, 6.0),
    "parameters.*.prior.kind": (
        "normal", "uniform", {"parameters.gain.prior": {"mean": 1.0, "sd": 0.1, "lower": 0.5, "upper": 2.0}},
    ),
    "parameters.*.prior.mean": (1.0, 2.0, {"parameters.gain.prior": {"kind": "normal", "sd": 0.1}}),
    "parameters.*.prior.sd": (0.1, 0.2, {"parameters.gain.prior": {"kind": "normal", "mean": 1.0}}),
    "parameters.*.prior.median": (1.0, 2.0, {"parameters.gain.prior": {"kind": "lognormal", "relative_sd": 0.1}}),
    "parameters.*.prior.relative_sd": (0.1, 0.2, {"parameters.gain.prior": {"kind": "lognormal", "median": 1.0}}),
    "parameters.*.prior.lower": (0.5, 0.6, {"parameters.gain.prior": {"kind": "uniform", "upper": 2.0}}),
    "parameters.*.prior.upper": (2.0, 3.0, {"parameters.gain.prior": {"kind": "uniform", "lower": 0.5}}),
    "fit.cost": ("posterior", "weighted"),
    "fit.method": ("pso+local", "local"),
    "fit.staged": (True, False),
    "fit.initial_states": ("reading", "estimated"),
    "fit.max_input_delay": (0.01, 0.02),
    "fit.stages.*.parameters": (["k"], ["gain"]),
    "fit.stages.*.outputs": (["y"], ["z"]),
    "fit.pso.particles": (10, 20),
    "fit.pso.iterations": (10, 20),
    "fit.pso.tolerance": (0.1, 0.2),
    "fit.local.iterations": (10, 20),
    "fit.local.tolerance": (1e-4, 1e-5),
    "fit.local.starts": (1, 2),
    "noise.process": ({"y": "estimated"}, {"y": 0.1}),
    "noise.initial_sd": ({"y": 0.1}, {"y": 0.2}, {"noise.process": {"y": "estimated"}}),
    "posterior.ensembles": (4, 5),
    "posterior.walkers": (20, 30),
    "posterior.max_steps": (100, 200),
    "posterior.max_minutes": (1.0, 2.0),
    "posterior.r_hat": (1.01, 1.02),
    "posterior.ess": (100, 200),
    "prediction.max_seconds": (1.0, 2.0),
    "loop.max_effects": (1, 2),
    "loop.max_minutes": (1.0, 2.0),
    "loop.held_out": (0.2, 0.3),
    "loop.effects": (["offset"], ["gain@u"]),
    "loop.exclude": (["offset"], ["u"]),
    "loop.require": (["gain@u"], ["offset@u"]),
    "loop.ports": (["u"], ["a"]),
    "loop.laws": (["offset"], ["gain"]),
    "solver.relative_tolerance": (1e-6, 1e-7),
    "solver.absolute_tolerance": (1e-6, 1e-7),
    "solver.time_limit": (1.0, 2.0),
}  # fmt: skip
READ_FIRST = ("model", "data", "parameters", "priors_from")

RIG = """model {name}
  extends Lib.Base;
  parameter Real gain(unit = "1", min = 0.1, max = 10) = {gain} "Gain";
  input Real u(unit = "V");
  input Real w(unit = "V");
  output Real y(unit = "rad") = a;
  output Real z(unit = "rad") = b;
  Real a(unit = "rad", start = 0, fixed = true);
  Real b(unit = "rad", start = 0, fixed = true);
equation
  der(a) = gain * u - k * a;
  der(b) = gain * w - k * b;
end {name};
"""
LIBRARY = """package Lib
  partial model Base
    parameter Real k(unit = "1/s", min = 0.01, max = 10) = {k} "Loss";
  end Base;
end Lib;
"""


def keys(section: type[BaseModel] = Config, prefix: str = "") -> Iterator[str]:
    """Every key that a file may have, ``*`` for names that the user chooses."""
    for name, field in section.model_fields.items():
        inner = [t for t in _types(field.annotation) if isinstance(t, type) and issubclass(t, BaseModel)]
        many = any(typing.get_origin(t) in (dict, tuple) for t in _types(field.annotation))
        if inner:
            yield from keys(inner[0], f"{prefix}{name}.{'*.' if many else ''}")
        else:
            yield f"{prefix}{name}"


def _types(annotation: object) -> Iterator[object]:
    yield annotation
    for argument in typing.get_args(annotation):
        yield from _types(argument)


def document(key: str, value: Any, also: Mapping[str, Any]) -> str:
    """A file that sets one key."""
    tables = json.loads(json.dumps(BASE))
    for path, setting in also.items():
        _put(tables, path.split("."), dict(setting))
    if key.startswith("fit.stages"):
        tables["fit"] = {"stages": [STAGE | {key.rpartition(".")[2]: value}]}
    else:
        _put(tables, key.replace("columns.*", "columns.y").replace("*", "gain").split("."), value)
    return "\n".join(f"{name} = {_toml(table)}" for name, table in tables.items())


def _put(table: dict[str, Any], path: list[str], value: Any) -> None:
    for part in path[:-1]:
        table = table.setdefault(part, {})
    table[path[-1]] = value


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{name} = {_toml(inner)}" for name, inner in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Models, libraries, FMUs and two recordings."""
    place = tmp_path_factory.mktemp("rig")
    both = RIG.format(name="Rig", gain=1.0) + RIG.format(name="Other", gain=1.5)
    (place / "Rig.mo").write_text(both)
    (place / "Changed.mo").write_text(RIG.format(name="Rig", gain=2.0))
    (place / "Lib.mo").write_text(LIBRARY.format(k=0.5))
    for name, k in (("one", 0.6), ("two", 0.7)):
        (place / name).mkdir()
        (place / name / "Lib.mo").write_text(LIBRARY.format(k=k))
        draws = {
            n: (("chain", "draw"), k + 0.01 * np.random.default_rng(1).normal(size=(4, 50))) for n in ("k", "gain")
        }
        xarray.Dataset(draws).to_netcdf(str(place / f"{name}.nc"), group="posterior", engine="h5netcdf")
    for name in ("Rig", "Other"):
        export_fmu(name, place / f"{name}.fmu", sources=[place / "Rig.mo", place / "Lib.mo"])
    time = np.arange(200) * 0.1
    u, w = np.sign(np.sin(time)), np.sign(np.cos(time))
    rows = np.column_stack([time, u, w, np.cumsum(u) * 0.1, np.cumsum(w) * 0.1])
    for name in ("a.csv", "b.csv"):
        np.savetxt(place / name, rows, delimiter=",", header="time,u,w,y,z", comments="")
    return place


@pytest.fixture(scope="module")
def rig(folder: Path) -> Job:
    return opened(folder, document("model.name", "Rig", {}))


def opened(folder: Path, text: str) -> Job:
    config = folder / "rig.toml"
    config.write_text(text)
    return open_job([folder / "a.csv", folder / "b.csv"], RunOptions(folder / "out", config=config))


def given(folder: Path, text: str, job: Job) -> Job:
    """A job under another file that changes nothing of what is read first."""
    (folder / "rig.toml").write_text(text)
    return replace(job, config=load_config(folder / "rig.toml"))


def reaches(command: str, job: Job) -> list[Any]:
    """Everything that the stages of a command are given."""
    signals = [{**r.inputs, **r.outputs} for r in job.recordings]
    readings = [{name: y.tobytes() for name, y in own.items()} for own in signals]
    if command == "close-loop":
        return [readings, job.name, job.config.model.sources, job.model.units, job.values, loop_settings(job)]
    stages: list[Any] = [fit_settings(job), job.config.prediction]
    stages += [sample_settings(job)] if command == "posterior" else []
    return [readings, job.name, job.model.parameters, job.model.units, job.parameters, job.fixed, *stages]


def test_no_key_is_forgotten():
    assert set(VALUES) == set(keys()) - {"solver.engine"}  # which has one value


@pytest.mark.parametrize("key", VALUES)
def test_a_key_acts(key, folder, rig):
    one, two, *also = VALUES[key]
    section = key.partition(".")[0]
    texts = [document(key, value, also[0] if also else {}) for value in (one, two)]
    first, second = (opened(folder, t) if section in READ_FIRST else given(folder, t, rig) for t in texts)
    for command in CONCERNS.get(section, ["fit", "posterior", "close-loop"]):
        if (command, key) != ("close-loop", "fit.cost"):  # which a loop refuses
            assert reaches(command, first) == reaches(command, first)
            assert reaches(command, first) != reaches(command, second)


@pytest.mark.parametrize("key", ["fit.method", "fit.local.starts", "solver.relative_tolerance"])
def test_what_the_user_says_goes_before_what_is_known_of_the_aero(key, folder):
    time = np.arange(200) * 0.1
    rows = np.column_stack([time, 12.0 * (time > 1.0), 0.1 * np.sin(1.3 * time)])
    np.savetxt(folder / "aero.csv", rows, delimiter=",", header="time,V_m,theta", comments="")
    job = open_job([folder / "aero.csv"], RunOptions(folder / "out-aero", "Aero.Systems.OneDof"))
    first, second = (loop_settings(given(folder, document(key, value, {}), job)) for value in VALUES[key][:2])
    assert first != second


def test_a_parameter_that_the_loop_does_not_free_keeps_the_users_value(folder):
    job = opened(folder, document("parameters.*.value", 2.0, {"parameters.gain": {"free": "auto"}}))
    settings = loop_settings(job)
    assert settings.parameters.names == ("k",)
    assert settings.fit.fixed == {"gain": 2.0}


def test_a_prior_that_is_given_stays_beside_one_from_an_earlier_experiment(folder):
    given = {"free": True, "prior": {"kind": "normal", "mean": 3.0, "sd": 1.0}}
    found = opened(folder, document("priors_from", "one.nc", {"parameters.gain": given})).parameters
    assert found["k"].start == pytest.approx(0.6, rel=0.01)  # where the draws lie
    assert found["gain"].prior.describe("") == "normal, 3 ± 1"


@pytest.mark.parametrize(("narrowed", "kept"), [
    ({}, {"gain@u", "offset@u", "gain@y"}),
    ({"effects": ("gain",)}, {"gain@u", "gain@y"}),
    ({"effects": ("offset@u",)}, {"offset@u"}),
    ({"exclude": ("u",)}, {"gain@y"}),
    ({"exclude": ("gain", "offset@u")}, set()),
    ({"ports": ("u",), "laws": ("gain",)}, {"gain@u"}),
    ({"exclude": ("gain",), "require": ("gain@y",)}, {"offset@u", "gain@y"}),
])  # fmt: skip
def test_what_the_engineer_narrows(narrowed, kept):
    every = [("gain@u", "gain", "u"), ("offset@u", "offset", "u"), ("gain@y", "gain", "y")]
    assert {c[0] for c in every if CandidateFilter(**narrowed).accepts(*c)} == kept
