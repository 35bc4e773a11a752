"""The embedded exporter: rumoca flattens, this package solves, a C compiler compiles."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

from aero_bayes.errors import InputError
from aero_bayes.export.build import compile_library, write_archive
from aero_bayes.export.causalise import ExplicitModel, causalise
from aero_bayes.export.codegen import generate
from aero_bayes.export.description import describe
from aero_bayes.export.flat import parse
from aero_bayes.export.layout import lay_out
from aero_bayes.export.library import check_model_name, identifier, stage
from aero_bayes.export.rumoca_front import flatten
from aero_bayes.export.source_check import locate
from aero_bayes.export.translate import translate
from aero_bayes.scratch import ScratchFolder

_NO_GUID = "{00000000-0000-0000-0000-000000000000}"


def explicit_model(model: str, sources: Sequence[Path] = ()) -> ExplicitModel:
    """Flatten and solve a Modelica model. Raises InputError for what cannot be translated."""
    with ScratchFolder() as root:
        text = flatten(check_model_name(model), root, stage(root, sources))
        try:
            return causalise(translate(parse(text)))
        except InputError as error:
            raise InputError(locate(str(error), model, root)) from None


def export_embedded(model: str, out: Path, sources: Sequence[Path] = ()) -> Path:
    """Write the FMU of ``model`` to ``out``."""
    solved = explicit_model(model, sources)
    layout = lay_out(solved)
    name = identifier(model)
    if not layout.states and not layout.outputs:
        raise InputError(f"{model}: the model has neither states nor outputs")
    source = generate(solved, layout, _NO_GUID)
    description = describe(solved, layout, model_name=model, identifier=name, guid=_NO_GUID)
    digest = hashlib.sha256(source.encode() + description).hexdigest()
    guid = "{" + "-".join((digest[:8], digest[8:12], digest[12:16], digest[16:20], digest[20:32])) + "}"
    library = compile_library(source.replace(_NO_GUID, guid), name)
    write_archive(
        out,
        {
            "modelDescription.xml": description.replace(_NO_GUID.encode(), guid.encode()),
            f"binaries/linux64/{name}.so": library,
        },
    )
    return out
