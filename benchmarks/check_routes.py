"""What this machine has for getting from a model to a simulation, and whether each route there gives right numbers.

A mass on a spring, whose motion is known in closed form, is exported, run and compared on every route.
"""

from __future__ import annotations

import importlib.metadata
import re
import shutil
import subprocess
import sys
import tempfile
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path

import click
import fmpy
import numpy as np

from aero_bayes.errors import CannotFinishError, InputError
from aero_bayes.modelica import export_fmu
from aero_bayes.modelica.build import c_compiler
from aero_bayes.modelica.library import library_roots, needed_libraries
from aero_bayes.simulation import Experiment, Model, Outcome, Problem, SolverSettings, confinement, open_simulator
from aero_bayes.structure.attach import attached
from aero_bayes.structure.compose import law_models
from aero_bayes.structure.coupled_fmu import couple
from aero_bayes.structure.fmu_ports import FmuBoundary
from aero_bayes.structure.law import shipped_laws
from aero_bayes.structure.law_blocks import LawBlocks
from aero_bayes.structure.placed_law import place_law

#: x'' = -k x from x = 1 at rest.
K, STOP, TOLERANCE = 9.0, 4.0, 1e-4
PLAIN = """model Spring
  output Real x(start = 1, fixed = true);
  Real v(start = 0, fixed = true);
equation
  der(x) = v;
  der(v) = -9 * x;
end Spring;
"""
LIBRARY = """model LibrarySpring
  Modelica.Mechanics.Translational.Components.Mass mass(m = 1, s(start = 1, fixed = true), v(start = 0, fixed = true));
  Modelica.Mechanics.Translational.Components.Spring spring(c = 9);
  Modelica.Mechanics.Translational.Components.Fixed ground;
  output Real x = mass.s;
equation
  connect(ground.flange, spring.flange_a);
  connect(spring.flange_b, mass.flange_a);
end LibrarySpring;
"""


#: Thirty small models of the standard library.
LIBRARY_MODELS = Path(__file__).parents[1] / "tests" / "export" / "MslModels.mo"


class NotHere(Exception):
    """The machine lacks what a route needs."""


def in_engine(path: Path) -> float:
    """Return the largest error of the compiled engine's run (FMPy's, for co-simulation FMUs)."""
    time = np.linspace(0.0, STOP, 201)
    problem = Problem(Model.load(path), (Experiment(time, ("x",)),), ((),), settings=SolverSettings(1e-8, 1e-8))
    with warnings.catch_warnings(action="ignore"), open_simulator(problem, workers=1) as simulator:
        found = simulator.simulate(np.zeros((1, 0)))
    if found.outcomes[0, 0] != Outcome.OK:
        raise CannotFinishError(Outcome(found.outcomes[0, 0]).text)
    return float(np.max(np.abs(found.outputs[0][0, :, 0] - np.cos(np.sqrt(K) * time))))


def in_fmpy(path: Path, kind: str) -> float:
    """Return the largest error of FMPy's run."""
    found = fmpy.simulate_fmu(str(path), fmi_type=kind, stop_time=STOP, output_interval=0.02, relative_tolerance=1e-8,
                              output=["x"])  # fmt: skip
    return float(np.max(np.abs(found["x"] - np.cos(np.sqrt(K) * found["time"]))))


def with_steps_only(path: Path, out: Path) -> Path:
    """Write the same FMU without Model Exchange."""
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(out, "w") as new:
        for name in old.namelist():
            data = old.read(name)
            if name == "modelDescription.xml":
                head, _, rest = data.partition(b"<ModelExchange")
                data = head + rest[rest.index(b"/>") + 2 :]
            new.writestr(name, data)
    return out


def with_law(path: Path, out: Path) -> Path:
    """Write the same FMU with a law around it that is off."""
    inner = Model.load(path)
    law = next(law for law in shipped_laws() if (law.kind, law.id) == ("output", "gain"))
    boundary, models = FmuBoundary(inner), law_models([law])
    port = next(p for p in boundary.ports if p.kind == "reading")
    placed = place_law(law, port, boundary.names.values())
    couple(attached(boundary.opened(), [placed], LawBlocks(models, out.parent)), out)
    return out


def version_of(command: list[str]) -> str:
    """Return the first line that a tool prints for ``--version``."""
    done = subprocess.run([*command, "--version"], capture_output=True, text=True, check=False)
    return (done.stdout.splitlines() or ["version unknown"])[0]


def tools() -> dict[str, str]:
    """List what is installed, by name."""
    found: dict[str, str] = {}
    try:
        found["C compiler"] = version_of(c_compiler())
    except InputError as error:
        found["C compiler"] = f"not here: {error}"
    for name in ("rumoca", "fmpy"):
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = f"not here: pip install {name}"
    omc = shutil.which("omc")
    found["OpenModelica"] = version_of([omc]) if omc else "not here: no omc on the PATH"
    try:
        roots = needed_libraries("Modelica.Any", [], library_roots())
        found["standard library"] = ", ".join(sorted(str(p) for p in roots.values()))
    except InputError as error:
        found["standard library"] = f"not here: {error}"
    return found


def library_models() -> list[str]:
    """Return names of the small models of the standard library; tests/export holds their numbers against rumoca's."""
    names = re.findall(r"^  model (\w+)", LIBRARY_MODELS.read_text(encoding="utf-8"), re.MULTILINE)
    return [f"{LIBRARY_MODELS.stem}.{name}" for name in names]


@click.command()
def main() -> None:
    """Print both tables; the exit status is 1 where a route that is there fails."""
    there = tools()
    for name, what in there.items():
        click.echo(f"{name:<18}{what}")
    for line in confinement.available().lines():
        click.echo(f"{'confinement':<18}{line}")
    click.echo()
    failed = False
    with tempfile.TemporaryDirectory() as name:
        for route, attempt in routes(Path(name), there):
            try:
                error = attempt()
                mark = "ok" if error < TOLERANCE else "FAILED"
                said = f"error {error:.1e}"
            except NotHere as missing:
                mark, said = "-", str(missing)
            except Exception as problem:  # whatever a tool throws is what this table is for
                mark, said = "FAILED", f"{type(problem).__name__}: {problem}".splitlines()[0]
            failed |= mark == "FAILED"
            click.echo(f"{mark:<8}{route:<58}{said}")
    sys.exit(failed)


def routes(folder: Path, there: dict[str, str]) -> list[tuple[str, Callable[[], float]]]:
    """List every route, and what runs it."""
    plain, library = folder / "Spring.mo", folder / "LibrarySpring.mo"
    plain.write_text(PLAIN, encoding="utf-8")
    library.write_text(LIBRARY, encoding="utf-8")
    built: dict[str, Path] = {}

    def need(*names: str) -> None:
        for name in names:
            if there[name].startswith("not here"):
                raise NotHere(f"{name} is {there[name]}")

    def fmu(key: str, make: Callable[[Path], Path]) -> Path:
        if key not in built:
            built[key] = make(folder / f"{key}.fmu")
        return built[key]

    def two() -> Path:
        need("C compiler", "rumoca")
        return fmu("two", lambda out: export_fmu("Spring", out, compiler="embedded", sources=[plain]))

    def three() -> Path:
        need("C compiler", "rumoca")
        return fmu("three", lambda out: export_fmu("Spring", out, compiler="embedded", sources=[plain], fmi=3))

    def omc() -> Path:
        need("OpenModelica")
        return fmu("omc", lambda out: export_fmu("Spring", out, compiler="omc", sources=[plain]))

    def of_library() -> Path:
        need("C compiler", "rumoca", "standard library")
        return fmu("msl", lambda out: export_fmu("LibrarySpring", out, compiler="embedded", sources=[library]))

    def exported(model: str) -> float:
        need("C compiler", "rumoca", "standard library")
        export_fmu(model, folder / "library.fmu", compiler="embedded", sources=[LIBRARY_MODELS])
        return 0.0

    return [
        ("Modelica -> FMI 2.0 Model Exchange -> engine", lambda: in_engine(two())),
        ("Modelica -> FMI 2.0 Model Exchange -> FMPy", lambda: in_fmpy(two(), "ModelExchange")),
        ("Modelica -> FMI 2.0 Co-Simulation -> FMPy", lambda: in_fmpy(two(), "CoSimulation")),
        ("Modelica -> FMI 3.0 Model Exchange -> engine", lambda: in_engine(three())),
        ("Modelica -> FMI 3.0 Model Exchange -> FMPy", lambda: in_fmpy(three(), "ModelExchange")),
        ("Modelica -> FMI 3.0 Co-Simulation -> FMPy", lambda: in_fmpy(three(), "CoSimulation")),
        ("FMI 2.0 with co-simulation only -> FMPy in workers",
         lambda: in_engine(fmu("steps", lambda out: with_steps_only(two(), out)))),
        ("FMI 2.0 without source, a law around it -> engine",
         lambda: in_engine(fmu("around", lambda out: with_law(two(), out)))),
        ("FMI 3.0 without source, a law around it -> engine",
         lambda: in_engine(fmu("around3", lambda out: with_law(three(), out)))),
        ("Modelica Standard Library -> FMI 2.0 -> engine", lambda: in_engine(of_library())),
        ("OpenModelica -> FMI 2.0 Model Exchange -> engine", lambda: in_engine(omc())),
        ("OpenModelica -> FMI 2.0 Co-Simulation -> FMPy", lambda: in_fmpy(omc(), "CoSimulation")),
        *((f"library model {model} -> FMI 2.0", lambda model=model: exported(model)) for model in library_models()),
    ]  # fmt: skip


if __name__ == "__main__":
    main()
