"""Values and starts that a fit holds and that may be wrong, as candidates beside the laws."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

from aero_bayes.errors import InputError
from aero_bayes.estimate.calibration import Calibration, recording_suffix
from aero_bayes.estimate.held_starts import held_starts
from aero_bayes.estimate.parameters import Parameter, parameters_from_model
from aero_bayes.laws.law_places import START, VALUE, CandidateFilter
from aero_bayes.loop.modelica_family import CandidateTerm
from aero_bayes.simulation.interface import ParameterTarget

#: Fixed values and starts that are tried, each; an FMU may have hundreds.
MOST_VALUES = 40
#: Shares of a fixed value at which a simulation is tried.
VALUE_SHARES = (0.7, 1.4)


def held_values(plain: Calibration, narrowed: CandidateFilter) -> dict[str, Parameter]:
    """What a fit leaves fixed and may be wrong, by the ids of the terms: values of parameters, starts of states."""
    model, fixed = plain.model, plain.fixed
    searched = {p.target.name for p in plain.parameters if isinstance(p.target, ParameterTarget)}
    found = [p for p in plain.parameters if p.free_if_identified and p.recording is None]
    for variable in model.parameters:
        start = fixed.get(variable.name, variable.start)
        if variable.name not in searched and start and isinstance(start, float):
            with suppress(InputError):
                (one,) = parameters_from_model(model, [variable.name])
                found.append(replace(one, start=start) if one.lower < start < one.upper else one)

    def wanted(p: Parameter) -> bool:
        return p.free_if_identified or narrowed.accepts(f"{VALUE}{p.name}", "value", p.name)

    values = {f"{VALUE}{p.name}": p for p in found[:MOST_VALUES] if wanted(p)}
    end = recording_suffix(plain.data.recordings, 0)
    # one start for all recordings
    starts = {
        f"{START}{state}": replace(own[0], name=own[0].name.removesuffix(end), recording=None, starts=(state,))
        for state, own in list(held_starts(plain).items())[:MOST_VALUES]
    }
    return values | {i: p for i, p in starts.items() if narrowed.accepts(i, "start", i.removeprefix(START))}


def held_candidate(id_: str, held: Parameter) -> CandidateTerm:
    """The candidate that a fixed value or start is wrong; a start has a value in each recording."""
    if id_.startswith(START):
        return CandidateTerm(id_, id_.removeprefix(START), ())
    tried = [v for v in (share * held.start for share in VALUE_SHARES) if held.lower < v < held.upper]
    return CandidateTerm(id_, held.name, tuple((v,) for v in tried) or ((held.upper,),))
