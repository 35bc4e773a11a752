"""Physical laws that a model may lack: read from Modelica, placed at ports, put into models."""

from __future__ import annotations

from typing import TYPE_CHECKING

from aero_bayes.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from aero_bayes.laws.candidate_filter import CandidateFilter as CandidateFilter
    from aero_bayes.laws.candidates import Candidate as Candidate
    from aero_bayes.laws.candidates import find_candidates as find_candidates
    from aero_bayes.laws.candidates import ports_with_laws as ports_with_laws
    from aero_bayes.laws.compose import LawModels as LawModels
    from aero_bayes.laws.compose import compose_law as compose_law
    from aero_bayes.laws.compose import compose_laws as compose_laws
    from aero_bayes.laws.compose import law_models as law_models
    from aero_bayes.laws.compose import with_candidates as with_candidates
    from aero_bayes.laws.compose import with_probes as with_probes
    from aero_bayes.laws.fmu_coupling import couple as couple
    from aero_bayes.laws.fmu_family import FmuFamily as FmuFamily
    from aero_bayes.laws.fmu_ports import FmuBoundary as FmuBoundary
    from aero_bayes.laws.law import LAW_INTERFACES as LAW_INTERFACES
    from aero_bayes.laws.law import SIGNAL_DEFAULTS as SIGNAL_DEFAULTS
    from aero_bayes.laws.law import Law as Law
    from aero_bayes.laws.law import read_laws as read_laws
    from aero_bayes.laws.law import shipped_laws as shipped_laws
    from aero_bayes.laws.model_family import CandidateTerm as CandidateTerm
    from aero_bayes.laws.model_family import CurveBasis as CurveBasis
    from aero_bayes.laws.model_family import ExtendedModel as ExtendedModel
    from aero_bayes.laws.model_family import ModelFamily as ModelFamily
    from aero_bayes.laws.model_sources import reserved_names as reserved_names
    from aero_bayes.laws.modelica_family import ModelicaFamily as ModelicaFamily
    from aero_bayes.laws.placed_law import PlacedLaw as PlacedLaw
    from aero_bayes.laws.placed_law import describe_law as describe_law
    from aero_bayes.laws.placed_law import identifier as identifier
    from aero_bayes.laws.placed_law import place_law as place_law
    from aero_bayes.laws.placed_law import place_laws as place_laws
    from aero_bayes.laws.write_model import WrittenModel as WrittenModel
    from aero_bayes.laws.write_model import write_law as write_law
    from aero_bayes.laws.write_model import write_laws as write_laws

__getattr__, __dir__ = lazy_exports(
    __name__,
    {
        "candidate_filter": "CandidateFilter",
        "candidates": "Candidate find_candidates ports_with_laws",
        "compose": "LawModels compose_law compose_laws law_models with_candidates with_probes",
        "fmu_coupling": "couple",
        "fmu_family": "FmuFamily",
        "fmu_ports": "FmuBoundary",
        "law": "LAW_INTERFACES Law SIGNAL_DEFAULTS read_laws shipped_laws",
        "model_family": "CandidateTerm CurveBasis ExtendedModel ModelFamily",
        "model_sources": "reserved_names",
        "modelica_family": "ModelicaFamily",
        "placed_law": "PlacedLaw describe_law identifier place_law place_laws",
        "write_model": "WrittenModel write_law write_laws",
    },
)
