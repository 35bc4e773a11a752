from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from fmpy.validation import validate_fmu
from written_effects import write_effects

from aero_bayes.modelica.compilers import export_fmu
from aero_bayes.modelica.library import declaration_of

BASE = "Aero.Systems.OneDof"


@pytest.fixture(scope="session")
def aero_fmu(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The FMU of a shipped system, by its short name; built once."""
    folder = tmp_path_factory.mktemp("fmu")

    def built(name: str) -> Path:
        path = folder / f"{name}.fmu"
        if not path.exists():
            export_fmu(f"Aero.Systems.{name}", path, compiler="embedded")
        return path

    return built


@pytest.fixture(scope="session")
def screening_fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """OneDof with every effect of the catalogue, switched off."""
    folder = tmp_path_factory.mktemp("screening")
    every: dict[str, dict[str, float]] = {id_: {} for id_ in declaration_of(BASE).effects}
    model = write_effects(BASE, every, folder, "OneDof_screening")
    return export_fmu(model.name, folder / "screening.fmu", compiler="embedded", sources=[model.path])


@pytest.fixture
def exported(modelica: Callable[..., Path]) -> Callable[..., Path]:
    """Writes a Modelica file, exports it, and returns the FMU, which FMPy finds valid."""

    def build(text: str, name: str = "") -> Path:
        source = modelica(text, name)
        path = export_fmu(source.stem, source.with_suffix(".fmu"), compiler="embedded", sources=[source])
        assert validate_fmu(str(path)) == []
        return path

    return build
