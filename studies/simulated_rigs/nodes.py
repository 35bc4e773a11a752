"""Under which names a law's place may be reported: its own, and connectors of its component."""

from __future__ import annotations

import re

from simulated_rigs.kinds import KINDS
from simulated_rigs.trial import RigTrial
from simulated_rigs.truth import LawTruth


def joined_connectors(source: str) -> list[set[str]]:
    """Find the sets of connectors that the ``connect`` equations of a Modelica text join."""
    nodes: list[set[str]] = []
    for pair in re.findall(r"connect\s*\(\s*([\w.]+)\s*,\s*([\w.]+)\s*\)", source):
        joined = [node for node in nodes if node & set(pair)]
        nodes = [node for node in nodes if node not in joined]
        nodes.append(set(pair).union(*joined))
    return nodes


def same_places(trial: RigTrial, law: LawTruth) -> list[str]:
    """Return the ids ``law@port`` that name this law at this place.

    A balance goes by its state or, where the state belongs to a component, by any connector that is joined to it. What
    is in series with a component is at its own connectors, or at the other end of a joint of two.
    """
    name, kind = law.place.name, law.place.kind
    names = [name]
    if kind == "output":
        # So called where it is a state itself, whose name stands for the balance.
        names.append(f"output_{name}")
    component = name.rpartition(".")[0]
    if component and kind in ("balance", "coupling"):
        series = kind == "coupling" or KINDS[trial.truth.kind].states[name].family == "electrical"
        for node in joined_connectors(trial.model.read_text(encoding="utf-8")):
            own = {connector for connector in node if connector.startswith(f"{component}.")}
            if own:
                names += sorted(own if series and len(node) > 2 else node)
    return [f"{law.law}@{one}" for one in dict.fromkeys(names)]
