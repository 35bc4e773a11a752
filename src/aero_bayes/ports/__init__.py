"""Ports: the places in a flat model where a term may be missing, and the nominal values of the signals there."""

from __future__ import annotations

from typing import TYPE_CHECKING

from aero_bayes.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from aero_bayes.ports.aliases import AliasStructure as AliasStructure
    from aero_bayes.ports.aliases import alias_structure as alias_structure
    from aero_bayes.ports.balance import Balance as Balance
    from aero_bayes.ports.balance import parameter_values as parameter_values
    from aero_bayes.ports.find import driver_names as driver_names
    from aero_bayes.ports.find import find_ports as find_ports
    from aero_bayes.ports.find import is_driver as is_driver
    from aero_bayes.ports.find import replaceable_ports as replaceable_ports
    from aero_bayes.ports.insertion_point import InsertionPoint as InsertionPoint
    from aero_bayes.ports.insertion_point import find_insertion_point as find_insertion_point
    from aero_bayes.ports.insertion_point import in_vector as in_vector
    from aero_bayes.ports.internal_signals import defining_equations as defining_equations
    from aero_bayes.ports.nominal_values import NEGLIGIBLE_TERM as NEGLIGIBLE_TERM
    from aero_bayes.ports.nominal_values import NOMINAL_QUANTILE as NOMINAL_QUANTILE
    from aero_bayes.ports.nominal_values import fastest_time_scale as fastest_time_scale
    from aero_bayes.ports.nominal_values import port_nominals as port_nominals
    from aero_bayes.ports.nominal_values import recorded_inputs as recorded_inputs
    from aero_bayes.ports.nominal_values import relative_change as relative_change
    from aero_bayes.ports.nominal_values import share_visited_twice as share_visited_twice
    from aero_bayes.ports.nominal_values import signal_nominal as signal_nominal
    from aero_bayes.ports.nominal_values import simulated_signals as simulated_signals
    from aero_bayes.ports.nominal_values import visited_range as visited_range
    from aero_bayes.ports.port import DIFFERENCE as DIFFERENCE
    from aero_bayes.ports.port import KELVIN as KELVIN
    from aero_bayes.ports.port import Attachment as Attachment
    from aero_bayes.ports.port import Port as Port
    from aero_bayes.ports.port import PortKind as PortKind
    from aero_bayes.ports.port import port_table as port_table
    from aero_bayes.ports.port import signal_expression as signal_expression
    from aero_bayes.ports.replaceable import CombinationRule as CombinationRule
    from aero_bayes.ports.replaceable import ReplaceableModel as ReplaceableModel
    from aero_bayes.ports.replaceable import find_replaceable_models as find_replaceable_models

__getattr__, __dir__ = lazy_exports(
    __name__,
    {
        "aliases": "AliasStructure alias_structure",
        "balance": "Balance parameter_values",
        "find": "driver_names find_ports is_driver replaceable_ports",
        "insertion_point": "InsertionPoint find_insertion_point in_vector",
        "internal_signals": "defining_equations",
        "nominal_values": "NEGLIGIBLE_TERM NOMINAL_QUANTILE fastest_time_scale port_nominals "
        "recorded_inputs relative_change share_visited_twice signal_nominal simulated_signals visited_range",
        "port": "Attachment DIFFERENCE KELVIN Port PortKind port_table signal_expression",
        "replaceable": "CombinationRule ReplaceableModel find_replaceable_models",
    },
)
