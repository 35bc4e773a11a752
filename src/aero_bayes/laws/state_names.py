"""Names of states: a model with laws may name a state otherwise than the base model does."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from xml.etree import ElementTree

from aero_bayes.export.compose import TRUE_SUFFIX
from aero_bayes.laws.coupled_fmu import UNREAD_SUFFIX
from aero_bayes.ports import AliasStructure
from aero_bayes.simulation.model import Model


def state_aliases(model: Model) -> dict[str, str]:
    """Return the state that each variable of an FMU 2.0 is an alias of: both have one value reference."""
    with zipfile.ZipFile(model.path) as archive:
        root = ElementTree.fromstring(archive.read("modelDescription.xml"))
    states = {str(s.value_reference): s.name for s in model.states}
    variables = [(v.get("name", ""), v.get("valueReference", "")) for v in root.iter("ScalarVariable")]
    return {name: states[reference] for name, reference in variables if reference in states}


def states_by_base_name(
    model: Model, structure: AliasStructure, aliases: Mapping[str, str], outputs: Mapping[str, str]
) -> dict[str, str]:
    """Return the states of a model with laws, by names of the base model."""
    found: dict[str, str] = {}
    for s in model.states:
        # the variable that a law at an output reads has the value that the output had without the law
        before_law = s.name.removesuffix(UNREAD_SUFFIX).removesuffix(TRUE_SUFFIX).replace(f"{TRUE_SUFFIX}[", "[")
        base = outputs.get(s.name, before_law if s.name not in aliases else s.name)
        found.setdefault(aliases.get(base, base), s.name)
        if base in structure.variables:
            found.setdefault(structure.of(base), s.name)
    return found


def state_names(base_model: Model, structure: AliasStructure, states: Mapping[str, str]) -> dict[str, str]:
    """Return the name in a model with laws of each state of the base model."""
    known = {s.name: structure.of(s.name) for s in base_model.states if s.name in structure.variables}
    return {s: states.get(s, states.get(same, s)) for s, same in known.items()}
