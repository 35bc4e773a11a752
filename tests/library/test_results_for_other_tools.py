"""What a fit writes for MATLAB, Dymola and Modelica says the same as the fit itself."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree
from zipfile import ZipFile

import numpy as np
import pytest
from scipy.io import loadmat

import aero_bayes


def test_matlab_reads_values_spread_and_units(cart: SimpleNamespace, tmp_path: Path) -> None:
    fit = cart.fit
    read = loadmat(fit.to_matlab(tmp_path / "cart.mat"), simplify_cells=True)["fitted"]
    names = list(read["name"])
    for name, entry in fit.parameters.items():
        k = names.index(name)
        assert (read["value"][k], read["unit"][k], read["parameter"][name]) == (entry.value, entry.unit, entry.value)
        np.testing.assert_equal(read["sd"][k], np.nan if entry.sd is None else entry.sd)
    covered = list(read["covariance_of"])
    for name in ("k", "d"):
        k = covered.index(name)
        assert read["covariance"][k, k] ** 0.5 == pytest.approx(fit[name].sd)
    np.testing.assert_array_equal(read["covariance"], np.transpose(read["covariance"]))


def test_the_script_for_matlab_says_the_same_as_the_file(cart: SimpleNamespace, tmp_path: Path) -> None:
    text = cart.fit.to_matlab(tmp_path / "cart.m").read_text("utf-8")
    assert float(re.search(r"^fitted\.parameter\.k = (\S+);$", text, re.M)[1]) == cart.fit["k"].value
    rows = re.search(r"^fitted\.covariance = \[(.*)\];$", text, re.M)[1].split("; ")
    np.testing.assert_array_equal([[float(x) for x in row.split()] for row in rows], cart.fit.parameter_covariance)
    assert all(line.startswith(("%", "fitted.", "clear ")) for line in text.splitlines())


def test_dymola_sets_what_was_fitted(cart: SimpleNamespace, tmp_path: Path) -> None:
    lines = cart.fit.to_dymola(tmp_path / "cart.mos").read_text("utf-8").splitlines()
    given = dict(re.findall(r"^(\w+) = ([^;]+);", "\n".join(lines), re.M))
    assert {name: float(value) for name, value in given.items()} == {
        "k": cart.fit["k"].value, "d": cart.fit["d"].value,
    }  # fmt: skip
    calls = [line.partition("(")[0] for line in lines if "(" in line and not line.startswith("//")]
    assert calls == ["openModel", "translateModel", "simulateModel"]


def test_what_is_exported_runs_as_long_as_the_recording(cart: SimpleNamespace, tmp_path: Path) -> None:
    shorter = aero_bayes.fit(
        cart.recording.slice(0.0, 12.0), cart.model, parameters=["k"], settings=aero_bayes.FitSettings("local"),
        workers=0,
    )  # fmt: skip
    end = shorter.calibration.data.experiments[0].time[-1]
    with ZipFile(shorter.export_fmu(tmp_path / "short.fmu")) as archive:
        root = ElementTree.fromstring(archive.read("modelDescription.xml"))
    assert float(root.find("DefaultExperiment").get("stopTime")) == pytest.approx(end)
    assert f"experiment(StopTime = {end:.12g})" in shorter.to_modelica()


def test_other_endings_and_missing_folders_are_refused(cart: SimpleNamespace, tmp_path: Path) -> None:
    with pytest.raises(aero_bayes.InputError, match=r"x\.txt.*\.m.*\.mat"):
        cart.fit.to_matlab(tmp_path / "x.txt")
    with pytest.raises(aero_bayes.InputError, match="no such folder"):
        cart.fit.to_dymola(tmp_path / "none" / "x.mos")
