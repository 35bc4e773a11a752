"""The embedded exporter: rumoca flattens, this package solves, a C compiler compiles."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path

from aero_bayes.errors import InputError
from aero_bayes.export.build import compile_library, write_archive
from aero_bayes.export.causalise import ExplicitModel, causalise
from aero_bayes.export.codegen import generate
from aero_bayes.export.description import describe
from aero_bayes.export.description_fmi3 import as_fmi3
from aero_bayes.export.flat import FlatModel
from aero_bayes.export.layout import lay_out
from aero_bayes.export.library import declared_members, identifier
from aero_bayes.export.rumoca_front import load_flat
from aero_bayes.export.translate import translate

_NO_GUID = "{00000000-0000-0000-0000-000000000000}"


def explicit_model(model: str, sources: Sequence[Path] = (), libraries: Sequence[Path] = ()) -> ExplicitModel:
    """Flatten and solve a Modelica model. Raises InputError for what cannot be translated."""
    return causalise(translate(load_flat(model, sources, libraries)))


def export_embedded(
    model: str, out: Path, sources: Sequence[Path] = (), libraries: Sequence[Path] = (), *, fmi: int = 2
) -> Path:
    """Write the FMU of ``model`` to ``out``."""
    return export_flat(load_flat(model, sources, libraries), out, fmi=fmi, members=declared_members(model, sources))


def export_flat(
    flat: FlatModel, out: Path, *, quick: bool = False, fmi: int = 2, members: Mapping[str, bytes] | None = None
) -> Path:
    """Write the FMU of a flat model to ``out``.

    Parameters
    ----------
    flat : FlatModel
    out : Path
    quick : bool
        Compile in less time to code that runs somewhat slower: for candidates that are tried and dropped.
    members : mapping of str to bytes, optional
        Further files of the archive.
    fmi : int
        2 or 3: version of the standard.

    Returns
    -------
    Path
        ``out``.

    Raises
    ------
    InputError
        For a construct that the exporter cannot translate.
    """
    solved = causalise(translate(flat))
    layout = lay_out(solved, sharing=fmi == 2)
    name = identifier(flat.name)
    if not layout.states and not layout.outputs:
        raise InputError(f"{flat.name}: the model has neither states nor outputs")
    source = generate(solved, layout, _NO_GUID)
    description = describe(solved, layout, model_name=flat.name, identifier=name, guid=_NO_GUID)
    if fmi == 3:
        description = as_fmi3(description, solved.indicators)
    digest = hashlib.sha256(source.encode() + description).hexdigest()
    guid = "{" + "-".join((digest[:8], digest[8:12], digest[12:16], digest[16:20], digest[20:32])) + "}"
    library = compile_library(source.replace(_NO_GUID, guid), name, quick=quick, fmi=fmi)
    write_archive(
        out,
        {
            "modelDescription.xml": description.replace(_NO_GUID.encode(), guid.encode()),
            f"binaries/{'linux64' if fmi == 2 else 'x86_64-linux'}/{name}.so": library,
            **(members or {}),
        },
    )
    return out
