"""Modelica source to FMU: flat models, their solution for the derivatives, and the C code and description of the FMU.

>>> from pathlib import Path
>>> from aero_bayes.modelica import export_fmu
>>> export_fmu("Aero.Systems.OneDof", Path("OneDof.fmu"))  # doctest: +SKIP
"""

from aero_bayes.modelica.arrays import Value
from aero_bayes.modelica.build import c_compiler, write_archive
from aero_bayes.modelica.causalisation import ExplicitModel, causalise
from aero_bayes.modelica.compilers import export_fmu, first_compiler
from aero_bayes.modelica.compose import (
    add_input,
    add_output,
    add_parameter,
    add_term,
    add_variable,
    attribute_value,
    equate,
    instantiate,
    rename_model,
    replace_uses,
    set_elements,
    set_parameter,
)
from aero_bayes.modelica.embedded import explicit_model, export_embedded, export_flat
from aero_bayes.modelica.equation_system import translate
from aero_bayes.modelica.expression import Builder, Node, evaluate_nodes
from aero_bayes.modelica.flat import FlatEquation, FlatModel, FlatVariable
from aero_bayes.modelica.library import declaration_of, library_roots, modelica_root, needed_libraries
from aero_bayes.modelica.library_view import link_packages, names_used_in
from aero_bayes.modelica.operators import Events, call_table
from aero_bayes.modelica.rumoca_front import load_flat
from aero_bayes.modelica.scope import Scope, possible_values
from aero_bayes.modelica.source_check import refuse_dropped

__all__ = [
    "Builder",
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
    "declaration_of",
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
    "possible_values",
    "refuse_dropped",
    "rename_model",
    "replace_uses",
    "set_elements",
    "set_parameter",
    "translate",
    "write_archive",
]
