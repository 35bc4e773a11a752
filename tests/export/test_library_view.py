"""What of a standard library a compiler gets to see."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from aero_bayes.modelica.library import link_packages, names_used_in

pytestmark = pytest.mark.fast

FILES = {
    "package.mo": "package Modelica\nend Modelica;\n",
    "Blocks/package.mo": "package Blocks\npackage Examples\n  model Heavy\n    Fluid.Pipe p;\n"
    "  end Heavy;\nend Examples;\nend Blocks;\n",
    "Blocks/Gain.mo": "block Gain \"not Fluid\" // nor Fluid\nend Gain;\n",
    "Fluid/package.mo": "package Fluid\nend Fluid;\n",
    "Fluid/Pipe.mo": "model Pipe\n  Modelica.Media.Water w;\nend Pipe;\n",
    "Media/package.mo": "package Media\nend Media;\n",
    "Media/Water.mo": "model Water\nend Water;\n",
    "Mechanics/package.mo": "package Mechanics\nend Mechanics;\n",
    "Mechanics/Rotational/package.mo": "package Rotational\nend Rotational;\n",
    "Mechanics/Rotational/Brake.mo": "model Brake\n  parameter Real mu0 =\n    getTable1DValueNoDer2(tableID, 1, 0);\n"
    "equation\n  mu = getTable1DValueNoDer2(tableID, 1, w);\nend Brake;\n",
}  # fmt: skip


@pytest.fixture
def library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    for name, text in FILES.items():
        file = tmp_path / "Modelica" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    return tmp_path / "Modelica"


def shown(folder: Path) -> set[str]:
    return {str(f.relative_to(folder / "Modelica")) for f in (folder / "Modelica").rglob("*.mo")}


def test_only_what_can_be_reached_is_there(library, tmp_path):
    always = {f for f in FILES if not f.startswith(("Fluid", "Media"))}
    assert shown(link_packages({"Modelica": library}, {"Modelica", "Blocks", "Gain"})) == always
    reached = link_packages({"Modelica": library}, {"Modelica", "Blocks", "Examples", "Heavy"})
    assert shown(reached) == set(FILES)
    assert shown(link_packages({"Modelica": library}, {"Media", "Water"})) == always | {
        f for f in FILES if "Media" in f
    }
    other = tmp_path / "Other"
    other.mkdir()
    (other / "package.mo").write_text("package Other\nend Other;\n", encoding="utf-8")
    both = link_packages({"Modelica": library, "Other": other})
    assert shown(both) == set(FILES)
    assert (both / "Other" / "package.mo").is_file()


def test_a_value_of_a_table_that_sets_a_parameter_is_a_number(library):
    text = (link_packages({"Modelica": library}) / "Modelica" / "Mechanics" / "Rotational" / "Brake.mo").read_text(
        "utf-8"
    )
    assert "sum({getTable1DValueNoDer2(tableID, 1, 0)});" in text
    assert "mu = getTable1DValueNoDer2(tableID, 1, w);" in text
    assert text.count("\n") == FILES["Mechanics/Rotational/Brake.mo"].count("\n")


def test_a_library_that_has_changed_is_read_anew(library):
    first = link_packages({"Modelica": library})
    assert link_packages({"Modelica": library}) == first
    file = library / "Blocks" / "Gain.mo"
    file.write_text("block Gain\n  Media.Water w;\nend Gain;\n", encoding="utf-8")
    os.utime(file, ns=(1, 1))
    assert link_packages({"Modelica": library}) != first
    assert "Media/Water.mo" in shown(link_packages({"Modelica": library}, {"Blocks", "Gain"}))


def test_words_are_those_of_the_code(tmp_path):
    (tmp_path / "A.mo").write_text('model A "text" /* more\n Text */\n  B.C d; // rest\nend A;\n', encoding="utf-8")
    assert names_used_in([tmp_path / "A.mo"]) == {"model", "A", "B", "C", "d", "end"}
