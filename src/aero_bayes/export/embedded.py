"""The embedded exporter: rumoca flattens, this package solves, a C compiler compiles."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from aero_bayes.errors import InputError
from aero_bayes.export.build import compile_binaries, source_files, write_archive
from aero_bayes.export.causalisation import ExplicitModel, causalise
from aero_bayes.export.codegen import generate
from aero_bayes.export.description_fmi2 import write_fmi2_description
from aero_bayes.export.description_fmi3 import build_description, convert_to_fmi3
from aero_bayes.export.equation_system import translate
from aero_bayes.export.flat import FlatModel
from aero_bayes.export.layout import lay_out
from aero_bayes.export.library import declared_members, identifier
from aero_bayes.export.platforms import Platform, this_machine
from aero_bayes.export.rumoca_front import load_flat
from aero_bayes.export.switching_surfaces import find_surfaces

_PLACED = re.compile(r"[^ :]+\.mo:\d+: ")
_NO_GUID = "{00000000-0000-0000-0000-000000000000}"


def explicit_model(model: str, sources: Sequence[Path] = (), libraries: Sequence[Path] = ()) -> ExplicitModel:
    """Flatten and solve a Modelica model. Raises InputError for what cannot be translated."""
    flat = load_flat(model, sources, libraries)
    with _placed(flat):
        return causalise(translate(flat))


@contextmanager
def _placed(flat: FlatModel) -> Iterator[None]:
    """Errors as one line that begins with file and line: of the variable that they name, or of the first one."""
    try:
        yield
    except (ArithmeticError, ValueError) as error:
        text = (
            str(error) if isinstance(error, InputError) else f"model {flat.name}: {error} with the values of constants"
        )
        words = set(re.findall(r"[\w.]+(?:\[[\d,]+\])?", text))
        places = [v.place for v in sorted(flat.variables, key=lambda v: v.name not in words) if v.place is not None]
        raise InputError(text if _PLACED.match(text) or not places else f"{places[0]}: {text}") from None


def export_embedded(
    model: str,
    out: Path,
    sources: Sequence[Path] = (),
    libraries: Sequence[Path] = (),
    *,
    fmi: int = 2,
    platforms: Sequence[Platform] = (),
    stop: float | None = None,
) -> Path:
    """Write the FMU of ``model`` to ``out``; see :func:`aero_bayes.export.export_fmu` and :func:`export_flat`."""
    flat, members = load_flat(model, sources, libraries), declared_members(model, sources)
    return export_flat(flat, out, fmi=fmi, members=members, platforms=platforms, stop=stop)


def export_flat(
    flat: FlatModel,
    out: Path | str,
    *,
    fmi: int = 2,
    members: Mapping[str, bytes] | None = None,
    platforms: Sequence[Platform] = (),
    stop: float | None = None,
) -> Path:
    """Write the FMU of a flat model to ``out``."""
    out, name = Path(out), identifier(flat.name)
    source, description = _with_guid(*_source_and_description(flat, fmi=fmi, stop=stop))
    files = source_files(source, name, fmi)
    if fmi == 3:
        files["buildDescription.xml"] = build_description(name)
    write_archive(
        out,
        {
            "modelDescription.xml": description,
            **compile_binaries(source, name, platforms or (this_machine(),), fmi=fmi),
            **{f"sources/{file}": text for file, text in files.items()},
            **(members or {}),
        },
    )
    return out


def _source_and_description(flat: FlatModel, *, fmi: int, stop: float | None) -> tuple[str, bytes]:
    """Write the C source and the model description, with no identifier yet."""
    with _placed(flat):
        switching = find_surfaces(causalise(translate(flat)))
        solved = switching.model
        layout = lay_out(solved, sharing=fmi == 2)
        if not layout.states and not layout.outputs:
            raise InputError(f"{flat.name}: the model has neither states nor outputs")
        source = generate(switching, layout, _NO_GUID)
        description = write_fmi2_description(
            solved, layout, model_name=flat.name, identifier=identifier(flat.name), guid=_NO_GUID, stop=stop,
        )  # fmt: skip
    return source, convert_to_fmi3(description, solved.indicators) if fmi == 3 else description


def _with_guid(source: str, description: bytes) -> tuple[str, bytes]:
    """Give source and description the identifier that follows from both."""
    digest = hashlib.sha256(source.encode() + description).hexdigest()
    guid = "{" + "-".join((digest[:8], digest[8:12], digest[12:16], digest[16:20], digest[20:32])) + "}"
    return source.replace(_NO_GUID, guid), description.replace(_NO_GUID.encode(), guid.encode())
