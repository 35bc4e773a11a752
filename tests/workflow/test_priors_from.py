"""``priors_from``: draws of an earlier experiment become the prior of those parameters that have none here."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray

import aero_bayes
from aero_bayes import InputError
from aero_bayes.commands.job import fit_parameters
from aero_bayes.config import load_config

pytestmark = pytest.mark.fast

TOML = """priors_from = "first/posterior.nc"
[parameters]
a = {free = true, lower = 1e-3, upper = 1e3}
b = {free = true, lower = -10, upper = 10}
c = {free = true, prior = {kind = "normal", mean = 3.0, sd = 1.0}, lower = -5, upper = 5}
"""
MODEL = aero_bayes.FunctionModel(
    lambda parameters, inputs, time: {"y": time}, outputs=["y"], parameters={"a": 1.0, "b": 1.0, "c": 1.0}
)


def test_the_path_is_from_the_file_and_a_prior_that_is_given_stays(tmp_path: Path) -> None:
    draws = np.random.default_rng(2).multivariate_normal([1.0, 2.0, 0.0], 0.01 * (0.5 * np.eye(3) + 0.5), (4, 200))
    group = xarray.Dataset({name: (("chain", "draw"), draws[..., k]) for k, name in enumerate("abc")})
    (tmp_path / "first").mkdir()
    (tmp_path / "rig.toml").write_text(TOML)
    with pytest.raises(InputError, match=r"first/posterior\.nc: is no posterior"):
        fit_parameters(MODEL, load_config(tmp_path / "rig.toml"))
    group.to_netcdf(str(tmp_path / "first" / "posterior.nc"), group="posterior", engine="h5netcdf")
    found = fit_parameters(MODEL, load_config(tmp_path / "rig.toml"))
    assert found["a"].start == pytest.approx(np.exp(np.log(draws[..., 0]).mean()))
    assert found["b"].start == pytest.approx(draws[..., 1].mean())
    assert found["c"].prior.describe("") == "normal, 3 ± 1"
    sizes = np.sqrt(
        np.linalg.inv(found.prior_curvature(found.prior_derivatives(found.to_search(found.start))[1], [0, 1]))
    )
    assert sizes[0, 0] == pytest.approx(np.log(draws[..., 0]).std(), rel=0.01)
    assert sizes[1, 1] * 20.0 == pytest.approx(draws[..., 1].std(), rel=0.01)
