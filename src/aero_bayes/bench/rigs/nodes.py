"""Under which names a law's place may be reported: the state, what shows it, and connectors of its component."""

from __future__ import annotations

import re

from aero_bayes.bench.rigs.trial import RigTrial
from aero_bayes.bench.rigs.truth import LawTruth


def connected(source: str) -> list[set[str]]:
    """Sets of connectors that ``connect`` equations of a Modelica text join."""
    nodes: list[set[str]] = []
    for pair in re.findall(r"connect\s*\(\s*([\w.]+)\s*,\s*([\w.]+)\s*\)", source):
        joined = [node for node in nodes if node & set(pair)]
        nodes = [node for node in nodes if node not in joined]
        nodes.append(set(pair).union(*joined))
    return nodes


def same_places(trial: RigTrial, law: LawTruth) -> list[str]:
    """Ids ``law@port`` that name this law at this place.

    A balance goes by its state, by the output that is that state, or, where the state belongs to a component, by any
    connector that is joined to that component.
    """
    name = law.place.name
    if law.place.kind == "output":
        # An output that is a state is told from that state's balance.
        return [f"{law.law}@{name}", f"{law.law}@output_{name}"]
    names = [name]
    if law.place.kind in ("balance", "coupling"):
        names += [trial.truth.aliases[name]] if name in trial.truth.aliases else []
        component = name.rpartition(".")[0]
        if component:
            for node in connected(trial.model.read_text(encoding="utf-8")):
                if any(connector.startswith(f"{component}.") for connector in node):
                    names += sorted(node)
    return [f"{law.law}@{one}" for one in dict.fromkeys(names)]
