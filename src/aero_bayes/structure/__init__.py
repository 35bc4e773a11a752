"""Physical laws that a model may lack: read from Modelica, placed at ports, put into models."""

from aero_bayes.structure.aliases import AliasStructure, alias_structure
from aero_bayes.structure.attach import OpenModel, attached
from aero_bayes.structure.balance import (
    DIFFERENCE,
    KELVIN,
    Attachment,
    Balance,
    CombinationRule,
    Port,
    ReplaceableModel,
    find_replaceable_models,
    parameter_values,
    port_table,
    signal_expression,
)
from aero_bayes.structure.candidates import Candidate, find_candidates, ports_with_laws
from aero_bayes.structure.compose import LawModels, compose_law, compose_laws, law_models, with_probes
from aero_bayes.structure.coupled_fmu import couple
from aero_bayes.structure.find import driver_names, find_ports, is_driver, replaceable_ports
from aero_bayes.structure.fmu_family import FmuPlaces
from aero_bayes.structure.fmu_ports import FmuBoundary
from aero_bayes.structure.insertion_point import InsertionPoint, find_insertion_point, in_vector
from aero_bayes.structure.internal_signals import defining_equations
from aero_bayes.structure.law import LAW_INTERFACES, Law, read_laws, shipped_laws
from aero_bayes.structure.law_blocks import LawBlocks
from aero_bayes.structure.law_places import CandidateFilter, LawPlaces
from aero_bayes.structure.model_family import CandidateTerm
from aero_bayes.structure.modelica_family import ModelicaFamily
from aero_bayes.structure.nominal_values import (
    NEGLIGIBLE_TERM,
    fastest_time_scale,
    port_nominals,
    recorded_inputs,
    relative_change,
    share_visited_twice,
    signal_nominal,
    simulated_signals,
    visited_range,
)
from aero_bayes.structure.placed_law import PlacedLaw, place_law, place_laws
from aero_bayes.structure.write_model import WrittenModel, reserved_names, write_laws

__all__ = [
    "DIFFERENCE",
    "KELVIN",
    "LAW_INTERFACES",
    "NEGLIGIBLE_TERM",
    "AliasStructure",
    "Attachment",
    "Balance",
    "Candidate",
    "CandidateFilter",
    "CandidateTerm",
    "CombinationRule",
    "FmuBoundary",
    "FmuPlaces",
    "InsertionPoint",
    "Law",
    "LawBlocks",
    "LawModels",
    "LawPlaces",
    "ModelicaFamily",
    "OpenModel",
    "PlacedLaw",
    "Port",
    "ReplaceableModel",
    "WrittenModel",
    "alias_structure",
    "attached",
    "compose_law",
    "compose_laws",
    "couple",
    "defining_equations",
    "driver_names",
    "fastest_time_scale",
    "find_candidates",
    "find_insertion_point",
    "find_ports",
    "find_replaceable_models",
    "in_vector",
    "is_driver",
    "law_models",
    "parameter_values",
    "place_law",
    "place_laws",
    "port_nominals",
    "port_table",
    "ports_with_laws",
    "read_laws",
    "recorded_inputs",
    "relative_change",
    "replaceable_ports",
    "reserved_names",
    "share_visited_twice",
    "shipped_laws",
    "signal_expression",
    "signal_nominal",
    "simulated_signals",
    "visited_range",
    "with_probes",
    "write_laws",
]
