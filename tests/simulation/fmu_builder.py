"""Builds the small test FMUs under fmus/ with the C compiler at hand."""

from __future__ import annotations

import re
import subprocess
import zipfile
from dataclasses import dataclass
from pathlib import Path

from aero_bayes.modelica.build import c_compiler

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
    depends: tuple[str, ...] | None = None


def state(name: str, reference: int, start: float, output: bool = True) -> list[Scalar]:
    """A state and its derivative (the next reference)."""
    return [
        Scalar(name, reference, "output" if output else "local", start),
        Scalar(f"der({name})", reference + 1, "local", derivative_of=name),
    ]


def parameter(name: str, reference: int, start: float) -> Scalar:
    return Scalar(name, reference, "parameter", start)


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
    "Stepping": [*state("x", 0, 0.0), parameter("b", 2, 0.0), parameter("ceiling", 3, 10.0)],
}
INDICATORS = {"BouncingBall": 1, "Loop": 1, "Rub": 1}
_TYPES = {"Real": "Float64", "Integer": "Int32", "Boolean": "Boolean"}


def _yes(value: bool) -> str:
    return str(value).lower()


def _interface(name: str, directional: bool, defines: tuple[str, ...]) -> str:
    three, steps = "FMI3" in defines, "STEPS" in defines
    given = {
        "modelIdentifier": name,
        f"providesDirectionalDerivative{'s' * three}": _yes(directional and not (three and steps)),
        "canBeInstantiatedOnlyOncePerProcess": _yes("ONCE" in defines),
    }
    if steps:
        given["canHandleVariableCommunicationStepSize"] = _yes("ONE_SIZE" not in defines)
        given["canInterpolateInputs"] = _yes("SLOPES" in defines)
    elif three:
        given["needsCompletedIntegratorStep"] = _yes("NO_CALLBACK" not in defines)
    else:
        given["completedIntegratorStepNotNeeded"] = _yes("NO_CALLBACK" in defines)
    return f"<{'CoSimulation' if steps else 'ModelExchange'} {_attributes(given)}/>"


def _attributes(given: dict[str, object]) -> str:
    return " ".join(f'{key}="{value}"' for key, value in given.items() if value is not None)


def description(name: str, model: str, directional: bool, defines: tuple[str, ...]) -> str:
    """The modelDescription.xml of a test model, of FMI 2.0 or 3.0, which names variables by number or by reference."""
    scalars, three = MODELS[model], "FMI3" in defines
    number = {scalar.name: scalar.reference if three else i + 1 for i, scalar in enumerate(scalars)}

    def variable(s: Scalar) -> str:
        constant = "fixed" if "FIXED" in defines else "tunable"
        usual = "continuous" if s.kind == "Real" else "discrete"
        exact = s.start is not None and s.causality in ("output", "local")
        outer = {
            "name": s.name, "valueReference": s.reference, "causality": s.causality,
            "variability": constant if s.causality == "parameter" else usual, "initial": "exact" if exact else None,
        }  # fmt: skip
        inner = {"start": s.start, "derivative": None if s.derivative_of is None else number[s.derivative_of]}
        if three:
            return f"<{_TYPES[s.kind]} {_attributes(outer | inner)}/>"
        return f"<ScalarVariable {_attributes(outer)}><{s.kind} {_attributes(inner)}/></ScalarVariable>"

    def unknown(s: Scalar, tag: str) -> str:
        known = None if s.depends is None else " ".join(str(number[d]) for d in s.depends)
        place = {"valueReference" if three else "index": number[s.name], "dependencies": known}
        return f"<{tag if three else 'Unknown'} {_attributes(place)}/>"

    outputs = "".join(unknown(s, "Output") for s in scalars if s.causality == "output")
    slopes = "".join(unknown(s, "ContinuousStateDerivative") for s in scalars if s.derivative_of is not None)
    indicators = INDICATORS.get(model, 0)
    if three:
        root = f'fmiVersion="3.0" instantiationToken="{name}"'
        structure = outputs + slopes + f'<EventIndicator valueReference="{scalars[0].reference}"/>' * indicators
    else:
        root = f'fmiVersion="2.0" guid="{name}" numberOfEventIndicators="{indicators}"'
        structure = f"<Outputs>{outputs}</Outputs>" + (f"<Derivatives>{slopes}</Derivatives>" if slopes else "")
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription {root} modelName="{name}">'
        f"{_interface(name, directional, defines)}<ModelVariables>{''.join(map(variable, scalars))}</ModelVariables>"
        f"<ModelStructure>{structure}</ModelStructure></fmiModelDescription>"
    )


def variables_in_c(model: str) -> str:
    """What a model's C source is compiled after: names, states and their derivatives, and start values."""
    reference = {s.name: s.reference for s in MODELS[model]}
    names = ((re.sub(r"[\W_]+", "_", name).strip("_").upper(), at) for name, at in reference.items())
    slopes = [s for s in MODELS[model] if s.derivative_of is not None]
    tables = {
        "unsigned states[]": [str(reference[str(s.derivative_of)]) for s in slopes] or ["0"],
        "unsigned derivatives[]": [str(s.reference) for s in slopes] or ["0"],
        "double starts[64]": [f"[{s.reference}] = {s.start}" for s in MODELS[model] if s.start is not None],
    }
    written = [f"static const {name} = {{{', '.join(values)}}};" for name, values in tables.items()]
    return "\n".join([f"enum {{ {', '.join(f'{name} = {at}' for name, at in names)} }};", *written, ""])


def build(folder: Path, model: str, *, directional: bool = True, defines: tuple[str, ...] = ()) -> Path:
    """Compile one test model and zip it as an FMU."""
    name = "_".join([model, "dd" if directional else "nodd", *defines])
    library = folder / f"{name}.so"
    variables = folder / f"{model}.h"
    variables.write_text(variables_in_c(model), encoding="utf-8")
    flags = ["-O2", "-w", "-fPIC", "-shared", "-fvisibility=hidden", *(f"-D{d}" for d in defines)]
    flags += ["-include", str(variables)]
    command = [*c_compiler(), *flags, "-o", str(library), str(SOURCES / f"{model}.c"), "-lm"]
    subprocess.run(command, check=True, capture_output=True)
    fmu = folder / f"{name}.fmu"
    place = "x86_64-linux" if "FMI3" in defines else "linux64"
    with zipfile.ZipFile(fmu, "w") as archive:
        archive.writestr("modelDescription.xml", description(name, model, directional, defines))
        archive.write(library, f"binaries/{place}/{name}.so")
        archive.writestr("resources/y.txt", "42.5")
    return fmu
