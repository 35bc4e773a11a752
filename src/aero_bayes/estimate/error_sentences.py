"""Sentences on the errors of models: where they fall and grow, and what is left."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from aero_bayes.data.split import span_words
from aero_bayes.display import join_names, with_unit
from aero_bayes.estimate.residual_tests import RecordingError

#: Ratio of two errors above which the error is said to grow.
MIN_GROWTH_RATIO = 1.05


def error_change(errors: Sequence[RecordingError], units: Mapping[str, str]) -> str:
    """Say in which part of the test the error falls most, and where it grows; empty without errors."""
    known = _compared(errors)
    if not known:
        return ""
    most = min(known, key=lambda e: e.change)
    worse = growing(known, units) if most.change < 1.0 else []
    told = f"On {place(most)} the error of {most.output} {_from_to(most, units)}"
    return ", but ".join(filter(None, (told, join_names(worse)))) + "."


def growing(errors: Sequence[RecordingError], units: Mapping[str, str]) -> list[str]:
    """Say where the error of an output grows clearly, or grows at all although it falls elsewhere."""
    fallen = {e.output for e in errors if e.change * MIN_GROWTH_RATIO < 1.0}
    grown = (e for e in _compared(errors) if e.change > (1.005 if e.output in fallen else MIN_GROWTH_RATIO))
    return [f"on {place(e)} the error of {e.output} {_from_to(e, units)}" for e in grown]


def _compared(errors: Sequence[RecordingError]) -> list[RecordingError]:
    """Return the errors with a value before and after, of those that are told first."""
    return told_first([e for e in errors if e.before])


def told_first(errors: Sequence[RecordingError]) -> list[RecordingError]:
    """Return the errors on test readings; where there are none those on validation readings, or else all."""
    by_role = ([e for e in errors if e.role == role] for role in ("test", "validation"))
    return next(filter(None, by_role), list(errors))


def _from_to(error: RecordingError, units: Mapping[str, str]) -> str:
    verb = "falls" if error.change < 1.0 else "grows"
    return with_unit(f"{verb} from {error.before:.3g} to {error.after:.3g}", units.get(error.output, ""))


def place(error: RecordingError) -> str:
    """Return a recording, or the part of it, and its role."""
    role = {"train": "training"}.get(error.role, error.role)
    span = span_words(error.begin, error.end)
    return f"the {role} part of {error.recording} ({span})" if span else f"the {role} recording {error.recording}"


def left_over(errors: Sequence[RecordingError]) -> list[str]:
    """Say of each output where the model does not explain it down to the noise, on what was not fitted first."""
    told = []
    order = ("test", "validation", "train")
    judged = sorted((e for e in errors if e.verdict != "noise"), key=lambda e: order.index(e.role))
    for output in dict.fromkeys(e.output for e in judged):
        own = [e for e in judged if e.output == output]
        large = [f"{_ratio(e)} on {place(e)}" for e in own if e.verdict == "too large"]
        small = [place(e) for e in own if e.verdict == "structured"]
        found = [f"is {join_names(large)}"] if large else []
        found += [f"has structure on {join_names(small)}"] if small else []
        told.append(f"The error of {output} {join_names(found)}.")
    return told


def _ratio(error: RecordingError) -> str:
    ratio = f"{error.ratio:.2g}" if error.ratio < 99.5 else "more than 100"
    return f"{ratio} times {'its noise' if error.noise_known else 'that of the fit'}"
