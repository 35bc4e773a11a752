"""A disk that is full, a folder that may not be written to: one line, status 3, no file that is half written."""

from __future__ import annotations

import re
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from facts import facts

from aero_bayes.modelica.compilers import export_fmu

CART = Path(__file__).parents[2] / "examples" / "cart"
FIT = "fit --model Rig.fmu --config rig.toml --data train.csv --out out --workers 1 --quiet"
INIT = "init Rig.mo train.csv --out made.toml"
FMU = "fmu --model Rig --source Rig.mo --out made.fmu"


@pytest.fixture(scope="module")
def cart(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cart")
    for name in ("Rig.mo", "rig.toml", "train.csv"):
        shutil.copyfile(CART / name, folder / name)
    export_fmu("Rig", folder / "Rig.fmu", sources=[folder / "Rig.mo"])
    return folder


def run(folder: Path, arguments: str, largest_file: int) -> tuple[int, list[str]]:
    """Status and last lines of a command that may write no file larger than so many bytes, as on a full disk."""
    done = subprocess.run(
        [sys.executable, "-c", "from aero_bayes.cli import main; main()", *arguments.split()],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (largest_file, largest_file)),
    )
    return done.returncode, [line for line in done.stderr.splitlines() if not line.endswith("...")]


@pytest.mark.long
@pytest.mark.parametrize(
    ("command", "largest_file"), [(INIT, 0), (INIT, 200), (FMU, 0), (FMU, 3000), (FIT, 0), (FIT, 60_000)]
)
def test_no_room_is_one_line(cart: Path, tmp_path: Path, command: str, largest_file: int) -> None:
    folder = Path(shutil.copytree(cart, tmp_path / "cart"))
    status, lines = run(folder, command, largest_file)
    assert status == 3
    assert len(lines) == 1
    written = {path.name for path in folder.rglob("*") if path.is_file()}
    # Result and page stand together or not at all; nothing of them is left half made.
    assert written <= {path.name for path in cart.iterdir()}


@pytest.mark.long
def test_a_folder_that_cannot_be_made_is_one_line(cart: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(cart, tmp_path / "cart"))
    (folder / "taken").write_text("a file")
    status, lines = run(folder, FIT.replace("--out out", "--out taken/out"), 1 << 30)
    assert (status, len(lines)) == (3, 1)
    assert re.search(facts("taken/out", "Not a directory"), lines[0])
