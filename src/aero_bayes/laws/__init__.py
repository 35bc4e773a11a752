"""Physical laws that a model may lack: read from Modelica, placed at ports, put into models."""

from aero_bayes.laws.attach import OpenModel, attached
from aero_bayes.laws.candidate_filter import CandidateFilter
from aero_bayes.laws.candidates import Candidate, find_candidates, ports_with_laws
from aero_bayes.laws.compose import LawModels, compose_law, compose_laws, law_models, with_candidates, with_probes
from aero_bayes.laws.coupled_fmu import couple
from aero_bayes.laws.fmu_places import FmuPlaces
from aero_bayes.laws.fmu_ports import FmuBoundary
from aero_bayes.laws.law import LAW_INTERFACES, Law, read_laws, shipped_laws
from aero_bayes.laws.law_blocks import LawBlocks
from aero_bayes.laws.law_places import LawPlaces
from aero_bayes.laws.model_family import CandidateTerm
from aero_bayes.laws.model_sources import reserved_names
from aero_bayes.laws.modelica_family import ModelicaFamily
from aero_bayes.laws.placed_law import PlacedLaw, place_law, place_laws
from aero_bayes.laws.write_model import WrittenModel, write_laws

__all__ = [
    "LAW_INTERFACES", "Candidate", "CandidateFilter", "CandidateTerm",
    "FmuBoundary", "FmuPlaces", "Law", "LawBlocks", "LawModels", "LawPlaces",
    "ModelicaFamily", "OpenModel", "PlacedLaw", "WrittenModel", "attached", "compose_law", "compose_laws", "couple",
    "find_candidates", "law_models", "place_law", "place_laws", "ports_with_laws", "read_laws",
    "reserved_names", "shipped_laws", "with_candidates", "with_probes", "write_laws",
]  # fmt: skip
