"""Ports found in a model, laws of a library, and laws written into the user's Modelica source.

>>> from pathlib import Path
>>> from aero_bayes.export.rumoca_front import load_flat
>>> from aero_bayes.physics import candidates, general_laws, ports_of
>>> flat, laws = load_flat("Rig", [Path("Rig.mo")]), general_laws()  # doctest: +SKIP
>>> ports = ports_of(flat, laws)  # doctest: +SKIP
>>> [c.id for c in candidates(ports, laws)]  # doctest: +SKIP
['gain@u', ..., 'coulomb_friction@v', ...]
"""

from __future__ import annotations

from aero_bayes.laws.candidates import Candidate, candidates, fits, ports_of
from aero_bayes.laws.compose import Models, compose_law, compose_laws, law_models, probe, screening
from aero_bayes.laws.law import Law, LawParameter, general_laws, laws_of
from aero_bayes.laws.use import Use, use_of
from aero_bayes.laws.write import Written, write_law
from aero_bayes.ports.port import Port, port_table

__all__ = [
    "Candidate",
    "Law",
    "LawParameter",
    "Models",
    "Port",
    "Use",
    "Written",
    "candidates",
    "compose_law",
    "compose_laws",
    "fits",
    "general_laws",
    "law_models",
    "laws_of",
    "port_table",
    "ports_of",
    "probe",
    "screening",
    "use_of",
    "write_law",
]
