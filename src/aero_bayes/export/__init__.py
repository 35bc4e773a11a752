"""Modelica source to FMU: flat models, their solution for the derivatives, and the C code and description of the FMU.

>>> from pathlib import Path
>>> from aero_bayes.export import export_fmu
>>> export_fmu("Aero.Systems.OneDof", Path("OneDof.fmu"))  # doctest: +SKIP
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from aero_bayes.export.arrays import Value, scalars
    from aero_bayes.export.build import c_compiler, compile_kept, write_archive
    from aero_bayes.export.causalisation import ExplicitModel, causalise
    from aero_bayes.export.compilers import Compiler, export_fmu, first_compiler
    from aero_bayes.export.compose import (
        ACTING_SUFFIX,
        TRUE_SUFFIX,
        add_input,
        add_output,
        add_parameter,
        add_term,
        add_variable,
        attribute_value,
        element_names,
        equate,
        instantiate,
        rename_model,
        replace_uses,
        separate_elements,
        set_parameter,
    )
    from aero_bayes.export.embedded import explicit_model, export_embedded, export_flat
    from aero_bayes.export.equation_system import EquationSystem, translate
    from aero_bayes.export.events import Events
    from aero_bayes.export.expression import Builder, Node, evaluate_nodes
    from aero_bayes.export.flat import FlatEquation, FlatModel, FlatVariable
    from aero_bayes.export.library import declaration_of, library_roots, modelica_root, needed_libraries
    from aero_bayes.export.library_view import link_packages, names_used_in, path_in_library
    from aero_bayes.export.rumoca_front import load_flat
    from aero_bayes.export.scope import Scope
    from aero_bayes.export.source_check import refuse_dropped
    from aero_bayes.export.tables import call_table
    from aero_bayes.export.value_sets import possible_values

#: The public names of the folder and the file of each; imported when first used, since SciPy takes long to load.
_HOME = {
    "Compiler": "compilers",
    "export_fmu": "compilers",
    "first_compiler": "compilers",
    "explicit_model": "embedded",
    "export_embedded": "embedded",
    "export_flat": "embedded",
    "load_flat": "rumoca_front",
    "FlatEquation": "flat",
    "FlatModel": "flat",
    "FlatVariable": "flat",
    "EquationSystem": "equation_system",
    "translate": "equation_system",
    "ExplicitModel": "causalisation",
    "causalise": "causalisation",
    "Builder": "expression",
    "Node": "expression",
    "evaluate_nodes": "expression",
    "Events": "events",
    "Scope": "scope",
    "Value": "arrays",
    "scalars": "arrays",
    "possible_values": "value_sets",
    "call_table": "tables",
    "refuse_dropped": "source_check",
    "ACTING_SUFFIX": "compose",
    "TRUE_SUFFIX": "compose",
    "add_input": "compose",
    "add_output": "compose",
    "add_parameter": "compose",
    "add_term": "compose",
    "add_variable": "compose",
    "attribute_value": "compose",
    "element_names": "compose",
    "equate": "compose",
    "instantiate": "compose",
    "rename_model": "compose",
    "replace_uses": "compose",
    "separate_elements": "compose",
    "set_parameter": "compose",
    "c_compiler": "build",
    "compile_kept": "build",
    "write_archive": "build",
    "declaration_of": "library",
    "library_roots": "library",
    "modelica_root": "library",
    "needed_libraries": "library",
    "link_packages": "library_view",
    "names_used_in": "library_view",
    "path_in_library": "library_view",
}

__all__ = [
    "ACTING_SUFFIX",
    "TRUE_SUFFIX",
    "Builder",
    "Compiler",
    "EquationSystem",
    "Events",
    "ExplicitModel",
    "FlatEquation",
    "FlatModel",
    "FlatVariable",
    "Node",
    "Scope",
    "Value",
    "add_input",
    "add_output",
    "add_parameter",
    "add_term",
    "add_variable",
    "attribute_value",
    "c_compiler",
    "call_table",
    "causalise",
    "compile_kept",
    "declaration_of",
    "element_names",
    "equate",
    "evaluate_nodes",
    "explicit_model",
    "export_embedded",
    "export_flat",
    "export_fmu",
    "first_compiler",
    "instantiate",
    "library_roots",
    "link_packages",
    "load_flat",
    "modelica_root",
    "names_used_in",
    "needed_libraries",
    "path_in_library",
    "possible_values",
    "refuse_dropped",
    "rename_model",
    "replace_uses",
    "scalars",
    "separate_elements",
    "set_parameter",
    "translate",
    "write_archive",
]


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return __all__
