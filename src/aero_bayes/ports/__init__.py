"""Ports: the places in a flat model where a term may be missing, and the nominal values of the signals there."""

from aero_bayes.ports.aliases import AliasStructure, alias_structure
from aero_bayes.ports.balance import Balance, parameter_values
from aero_bayes.ports.find import driver_names, find_ports, is_driver, replaceable_ports
from aero_bayes.ports.insertion_point import InsertionPoint, find_insertion_point, in_vector
from aero_bayes.ports.internal_signals import defining_equations
from aero_bayes.ports.nominal_values import NEGLIGIBLE_TERM, port_nominals, recorded_inputs, simulated_signals
from aero_bayes.ports.port import DIFFERENCE, KELVIN, Attachment, Port, port_table, signal_expression
from aero_bayes.ports.replaceable import CombinationRule, ReplaceableModel, find_replaceable_models
from aero_bayes.ports.signal_statistics import (
    fastest_time_scale,
    relative_change,
    share_visited_twice,
    signal_nominal,
    visited_range,
)

__all__ = [
    "DIFFERENCE", "KELVIN", "NEGLIGIBLE_TERM", "AliasStructure", "Attachment", "Balance",
    "CombinationRule", "InsertionPoint", "Port", "ReplaceableModel", "alias_structure",
    "defining_equations", "driver_names", "fastest_time_scale", "find_insertion_point", "find_ports",
    "find_replaceable_models", "in_vector", "is_driver", "parameter_values", "port_nominals", "port_table",
    "recorded_inputs", "relative_change", "replaceable_ports", "share_visited_twice", "signal_expression",
    "signal_nominal", "simulated_signals", "visited_range",
]  # fmt: skip
