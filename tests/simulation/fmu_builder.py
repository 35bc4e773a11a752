"""Builds the small test FMUs under fmus/ with the C compiler at hand."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from dataclasses import dataclass
from pathlib import Path

SOURCES = Path(__file__).parent / "fmus"


@dataclass(frozen=True)
class Scalar:
    """One variable of a test model: ``derivative_of`` names the state, ``depends`` what the model structure says."""

    name: str
    reference: int
    causality: str
    start: float | None = None
    derivative_of: str | None = None
    kind: str = "Real"
    nominal: float | None = None
    calculated: bool = False
    depends: tuple[str, ...] | None = None


def state(name: str, reference: int, start: float, output: bool = True, nominal: float | None = None) -> list[Scalar]:
    """A state and its derivative (the next reference)."""
    return [
        Scalar(name, reference, "output" if output else "local", start, nominal=nominal),
        Scalar(f"der({name})", reference + 1, "local", derivative_of=name),
    ]


def parameter(name: str, reference: int, start: float, nominal: float | None = None) -> Scalar:
    return Scalar(name, reference, "parameter", start, nominal=nominal)


MODELS: dict[str, list[Scalar]] = {
    "Dahlquist": [
        *state("x", 0, 1.0),
        parameter("k", 2, 1.0),
        parameter("a", 3, 0.0),
        parameter("w", 4, 1.0),
        parameter("b", 5, 1.0),
        Scalar("u", 6, "input", 0.0),
        Scalar("y", 7, "output"),
        parameter("c", 8, 0.0),
        parameter("g", 9, 0.0),
    ],
    "Swing": [
        *state("x", 0, 1.0),
        *state("v", 2, 0.0),
        parameter("k", 4, 1.0),
        parameter("d", 5, 0.3),
        parameter("width", 6, 0.02),
        *(Scalar(name, 7 + i, "output") for i, name in enumerate(("linear", "smooth", "kink", "bump"))),
    ],
    "VanDerPol": [*state("x0", 0, 2.0), *state("x1", 2, 0.0), parameter("mu", 4, 1.0)],
    "BouncingBall": [*state("h", 0, 1.0), *state("v", 2, 0.0), parameter("g", 4, -9.81), parameter("e", 5, 0.7)],
    "Rub": [*state("s", 0, 0.1), *state("v", 2, 0.0), parameter("k", 4, 40.0), parameter("F_c", 5, 0.5)],
    "Stair": [
        *state("x", 0, 0.0),
        Scalar("counter", 2, "output", kind="Integer"),
        parameter("period", 3, 0.3),
        parameter("kick", 4, 0.0),
    ],
    "Ticker": [Scalar("count", 0, "output", kind="Integer"), Scalar("y", 1, "output"), parameter("period", 2, 0.3)],
    "Feedthrough": [
        Scalar("u", 0, "input", 0.0),
        Scalar("y", 1, "output"),
        parameter("gain", 2, 1.0),
        parameter("offset", 3, 0.0),
        Scalar("resource", 4, "output"),
    ],
    "Circuit": [
        *(s for k in range(3) for s in (*state(f"i{k}", 4 * k, 0.0, k == 0), *state(f"v{k}", 4 * k + 2, 0.0, k == 2))),
        Scalar("u", 12, "input", 0.0),
        parameter("R", 13, 10.0),
        parameter("L", 14, 1e-4),
        parameter("C", 15, 1e-3),
        parameter("G", 16, 1e-3),
        Scalar("power", 17, "output"),
    ],
    "Trouble": [*state("x", 0, 1.0), parameter("mode", 2, 0.0)],
    "Copies": [
        *state("_D_outputAlias_h", 0, 0.5, output=False),
        *state("v_inside", 2, 1.0, output=False),
        Scalar("h", 4, "output", depends=("_D_outputAlias_h",)),
        Scalar("v", 5, "output", depends=("v_inside",)),
        parameter("k", 6, 1.0),
        Scalar("scaled", 7, "output", depends=("v_inside",)),
        Scalar("clipped", 8, "output", depends=("v_inside",)),
        parameter("w", 9, 1.0),
        Scalar("driven", 10, "output", depends=("_D_outputAlias_h", "u")),
        Scalar("u", 40, "input", 0.0),
    ],
    "Loop": [*state("x", 0, 1.0), Scalar("z", 2, "output"), parameter("a", 3, 0.5), parameter("c", 4, 0.2)],
    "Circle": [*state("x", 0, 0.1), Scalar("y", 2, "output")],
    "Wide": [
        *(
            Scalar(name, reference, "local", derivative_of=of, start=None if of else 0.0, depends=depends)
            for name, reference, of, depends in (
                ("_D_outputAlias_i", 0, None, None),
                ("der(i)", 1, "_D_outputAlias_i", ("_D_outputAlias_i", "_D_outputAlias_w", "u")),
                ("_D_outputAlias_w", 2, None, None),
                ("der(w)", 3, "_D_outputAlias_w", ("_D_outputAlias_i", "_D_outputAlias_w")),
                ("q", 4, None, None),
                ("der(q)", 5, "q", ("_D_outputAlias_w", "q", "_D_outputAlias_theta")),
                ("_D_outputAlias_theta", 6, None, None),
                ("der(theta)", 7, "_D_outputAlias_theta", ("q",)),
            )
        ),
        *(
            Scalar(name, 8 + i, "output", depends=(f"_D_outputAlias_{name}",))
            for i, name in enumerate(("i", "w", "theta"))
        ),
        *(
            parameter(name, 11 + i, value)
            for i, (name, value) in enumerate(
                zip("RLKJDGBS", (8.4, 1.16e-3, 0.042, 8.7e-6, 2.4e-8, 8.4e-7, 6e-3, 0.09), strict=True)
            )
        ),
        Scalar("u", 40, "input", 0.0),
    ],
    "Stepping": [*state("x", 0, 0.0), parameter("b", 2, 0.0), parameter("ceiling", 3, 10.0)],
}
INDICATORS = {"BouncingBall": 1, "Loop": 1, "Rub": 1}


def _variable(scalar: Scalar, index: dict[str, int], fixed: bool) -> str:
    constant = scalar.causality == "parameter"
    variability = (
        ("fixed" if fixed else "tunable") if constant else "discrete" if scalar.kind != "Real" else "continuous"
    )
    attributes = ""
    if scalar.start is not None and not scalar.calculated:
        attributes += f' start="{scalar.start!r}"'
    if scalar.nominal is not None:
        attributes += f' nominal="{scalar.nominal!r}"'
    if scalar.derivative_of is not None:
        attributes += f' derivative="{index[scalar.derivative_of]}"'
    initial = ' initial="exact"' if scalar.start is not None and scalar.causality in ("output", "local") else ""
    return (
        f'<ScalarVariable name="{scalar.name}" valueReference="{scalar.reference}" causality="{scalar.causality}" '
        f'variability="{variability}"{initial}><{scalar.kind}{attributes}/></ScalarVariable>'
    )


def description(name: str, model: str, directional: bool, extra: str = "", fixed: bool = False) -> str:
    """The modelDescription.xml of a test model."""
    scalars = MODELS[model]
    index = {scalar.name: i + 1 for i, scalar in enumerate(scalars)}

    def unknown(s: Scalar) -> str:
        known = "" if s.depends is None else f' dependencies="{" ".join(str(index[d]) for d in s.depends)}"'
        return f'<Unknown index="{index[s.name]}"{known}/>'

    derivatives = "".join(unknown(s) for s in scalars if s.derivative_of is not None)
    derivatives = f"<Derivatives>{derivatives}</Derivatives>" if derivatives else ""
    outputs = "".join(unknown(s) for s in scalars if s.causality == "output")
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="2.0" modelName="{name}" guid="{name}" '
        f'numberOfEventIndicators="{INDICATORS.get(model, 0)}"><ModelExchange modelIdentifier="{name}" '
        f'providesDirectionalDerivative="{str(directional).lower()}"{extra}/>'
        f"<ModelVariables>{''.join(_variable(s, index, fixed) for s in scalars)}</ModelVariables>"
        f"<ModelStructure><Outputs>{outputs}</Outputs>{derivatives}</ModelStructure>"
        "</fmiModelDescription>"
    )


_TYPES = {"Real": "Float64", "Integer": "Int32", "Boolean": "Boolean"}


def description3(name: str, model: str, directional: bool, defines: tuple[str, ...]) -> str:
    """The same for FMI 3.0."""
    scalars = MODELS[model]
    reference = {scalar.name: scalar.reference for scalar in scalars}

    def variable(scalar: Scalar) -> str:
        attributes = f'name="{scalar.name}" valueReference="{scalar.reference}" causality="{scalar.causality}"'
        if scalar.causality == "parameter":
            attributes += ' variability="tunable"'
        elif scalar.start is not None and scalar.causality != "input":
            attributes += ' initial="exact"'
        if scalar.start is not None:
            attributes += f' start="{scalar.start!r}"'
        if scalar.derivative_of is not None:
            attributes += f' derivative="{reference[scalar.derivative_of]}"'
        return f"<{_TYPES[scalar.kind]} {attributes}/>"

    structure = "".join(
        f'<Output valueReference="{s.reference}"'
        + ("" if s.depends is None else f' dependencies="{" ".join(str(reference[d]) for d in s.depends)}"')
        + "/>"
        for s in scalars
        if s.causality == "output"
    )
    structure += "".join(
        f'<ContinuousStateDerivative valueReference="{s.reference}"/>' for s in scalars if s.derivative_of is not None
    )
    indicator = f'<EventIndicator valueReference="{scalars[0].reference}"/>' * INDICATORS.get(model, 0)
    steps, callback = "STEPS" in defines, str("NO_CALLBACK" not in defines).lower()
    kind = "CoSimulation" if steps else "ModelExchange"
    extra = f' providesDirectionalDerivatives="{str(directional).lower()}" needsCompletedIntegratorStep="{callback}"'
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="3.0" modelName="{name}" '
        f'instantiationToken="{name}"><{kind} modelIdentifier="{name}"'
        + (' canHandleVariableCommunicationStepSize="true"' if steps else extra)
        + f"/><ModelVariables>{''.join(variable(s) for s in scalars)}</ModelVariables>"
        f"<ModelStructure>{structure}{indicator}</ModelStructure></fmiModelDescription>"
    )


def compiler() -> list[str]:
    """The C compiler: $CC, cc, or the ziglang wheel's."""
    for name in (os.environ.get("CC"), "cc", "gcc", "clang"):
        if name and shutil.which(name):
            return [name]
    return [sys.executable, "-m", "ziglang", "cc"]


def build(folder: Path, model: str, *, directional: bool = True, defines: tuple[str, ...] = ()) -> Path:
    """Compile one test model and zip it as an FMU."""
    name = "_".join([model, "dd" if directional else "nodd", *defines])
    library = folder / f"{name}.so"
    flags = ["-O2", "-w", "-fPIC", "-shared", "-fvisibility=hidden", *(f"-D{d}" for d in defines)]
    command = [*compiler(), *flags, "-o", str(library), str(SOURCES / f"{model}.c"), "-lm"]
    subprocess.run(command, check=True, capture_output=True)
    extra = ' canBeInstantiatedOnlyOncePerProcess="true"' if "ONCE" in defines else ""
    extra += ' completedIntegratorStepNotNeeded="true"' if "NO_CALLBACK" in defines else ""
    fmu = folder / f"{name}.fmu"
    steps = "STEPS" in defines
    if "FMI3" in defines:
        described, place = description3(name, model, directional, defines), "x86_64-linux"
    else:
        described, place = description(name, model, directional, extra, "FIXED" in defines), "linux64"
        if steps:
            any_step, slopes = (str(yes).lower() for yes in ("ONE_SIZE" not in defines, "SLOPES" in defines))
            described = described.replace(
                "<ModelExchange",
                f'<CoSimulation canHandleVariableCommunicationStepSize="{any_step}" canInterpolateInputs="{slopes}"',
            )
    with zipfile.ZipFile(fmu, "w") as archive:
        archive.writestr("modelDescription.xml", described)
        archive.write(library, f"binaries/{place}/{name}.so")
        archive.writestr("resources/y.txt", "42.5")
    return fmu
