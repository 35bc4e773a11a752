"""Sentences on what a loop found, for the page, the terminal and a notebook.

An effect is a :class:`~aero_bayes.loop.extend.FoundEffect` or its entry of result.json, an error alike."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from aero_bayes.display import join_names, with_unit

#: Alternatives that are listed by name.
MAX_NAMED = 3
#: Ratio of two errors above which the error is said to grow.
MIN_GROWTH_RATIO = 1.05
_COUNTS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")


def lacking(effects: Sequence[Any]) -> str:
    """Say what the model lacks, as far as the data say it, and with what it was extended as required."""
    asked = [e.id for e in effects if e.claim is None]
    found = [e for e in effects if e.claim is not None]
    if len(found) > 1 and any(e.claim == "one of" for e in found):
        told = f"lacks {_number(len(found))} effects"
    else:
        told = f"lacks {join_names([_what(e) for e in found])}" if found else ""
    return " and ".join(filter(None, (told, f"has {join_names(asked)}, as required" if asked else "")))


def _what(effect: Any) -> str:
    if effect.claim == "one of":
        return f"one of {_number(1 + len(effect.alternatives))} effects, such as {in_words(effect) or effect.id}"
    if effect.kind == "free_form" or effect.claim == "place":
        return f"an effect at {effect.port}"
    return in_words(effect) or str(effect.id)


def in_words(effect: Any) -> str:
    """Return what an effect is, without the note on its place; empty where no words are known."""
    return re.sub(r" \([^()]*\)$", "", effect.summary)


def _number(count: int) -> str:
    """Return a small whole number as a word."""
    return _COUNTS[count] if count < len(_COUNTS) else str(count)


def cross_validated(effect: Any, name: str) -> str:
    """Say how far an effect lowers the error on readings that were left out of the fit; ``name`` is what it is called.

    Empty where that is not known."""
    if effect.share is None:
        return ""
    verb, change = ("raises", effect.share - 1.0) if effect.share > 1.0 else ("lowers", 1.0 - effect.share)
    spread = f" ± {100.0 * effect.share_sd:.0f}" if (effect.share_sd or 0.0) >= 0.005 else ""
    of = f" of {effect.share_of}" if effect.share_of else ""
    return f"Cross-validated on training, {name} {verb} the error{of} by {100.0 * change:.0f}{spread} %."


def claimed(effect: Any, name: str, others: str = "") -> str:
    """Say how sure it is that the effect is this one; empty for one that the configuration requires.

    ``others`` stands for what the data do not tell from it where that is listed elsewhere."""
    known = list(effect.alternatives)
    if effect.claim is None:
        return ""
    if effect.claim == "law":
        if effect.kind != "free_form":
            return f"{'No other law' if known else 'Nothing else'} that was tried does as well as {name}."
        like = f"; it looks like {effect.looks_like}" if effect.looks_like else ""
        return f"No law of the library does as well as {name}, a curve that was learned from the data{like}."
    ids = [one.id for one in known]
    if len(ids) > MAX_NAMED:
        ids = [*ids[: MAX_NAMED - 1], f"{len(ids) - MAX_NAMED + 1} more"]
    told = f"The data do not tell {name} from {others or join_names(ids)}: {_how_near(known)}." if ids else ""
    place = "The place is known, the law is not." if effect.claim == "place" else ""
    return " ".join(filter(None, (told, place)))


def _how_near(others: Sequence[Any]) -> str:
    """Say how much worse than the chosen term the worst of those predicts that the data do not tell from it."""
    them = "it" if len(others) == 1 else "them"
    worst = max((one.error_ratio or 1.0) - 1.0 for one in others)
    if worst < 0.01:
        return f"with {them} the left-out error is the same"
    return f"with {them} the left-out error is {'' if len(others) == 1 else 'at most '}{100.0 * worst:.0f} % larger"


def error_change(errors: Sequence[Any], units: Mapping[str, str]) -> str:
    """Say in which recording that was not fitted the error falls most, and where it grows; empty without errors."""
    known = _compared(errors)
    if not known:
        return ""
    most = min(known, key=lambda e: e.after / e.before)
    worse = growing(known, units) if most.after < most.before else []
    told = f"On {place(most)} the error of {most.output} {_from_to(most, units)}"
    return ", but ".join(filter(None, (told, join_names(worse)))) + "."


def growing(errors: Sequence[Any], units: Mapping[str, str]) -> list[str]:
    """Say where the error of an output grows clearly, or grows at all although it falls elsewhere."""
    fallen = {e.output for e in errors if e.before and e.after * MIN_GROWTH_RATIO < e.before}
    grown = (e for e in _compared(errors) if e.after > (1.005 if e.output in fallen else MIN_GROWTH_RATIO) * e.before)
    return [f"on {place(e)} the error of {e.output} {_from_to(e, units)}" for e in grown]


def _compared(errors: Sequence[Any]) -> list[Any]:
    """Return the errors with a value before and after, those on recordings that were not fitted if there are any."""
    known = [e for e in errors if e.before and e.after is not None]
    return [e for e in known if e.role == "test"] or known


def _from_to(error: Any, units: Mapping[str, str]) -> str:
    verb = "falls" if error.after < error.before else "grows"
    return with_unit(f"{verb} from {error.before:.3g} to {error.after:.3g}", units.get(error.output, ""))


def place(error: Any) -> str:
    """Return a recording and its role, or the part of it that was not fitted."""
    if error.begin is not None:
        return f"what was not fitted of {error.recording} (from {error.begin:.6g} s on)"
    return f"the {'test' if error.role == 'test' else 'training'} recording {error.recording}"


def left_over(errors: Sequence[Any]) -> list[str]:
    """Say of each output where the model does not explain it down to the noise, on what was not fitted first."""
    told = []
    judged = sorted((e for e in errors if e.verdict != "noise"), key=lambda e: e.role != "test")
    for output in dict.fromkeys(e.output for e in judged):
        own = [e for e in judged if e.output == output]
        large = [f"{_ratio(e)} on {place(e)}" for e in own if e.verdict == "too large"]
        small = [place(e) for e in own if e.verdict == "structured"]
        found = [f"is {join_names(large)}"] if large else []
        found += [f"has structure on {join_names(small)}"] if small else []
        told.append(f"The error of {output} {join_names(found)}.")
    return told


def _ratio(error: Any) -> str:
    ratio = f"{error.ratio:.2g}" if (error.ratio or 0.0) < 99.5 else "more than 100"
    return f"{ratio} times {'its noise' if error.noise_known else 'that of the fit'}"


def extended_sentence(base: str, effects: Sequence[Any], errors: Sequence[Any], units: Mapping[str, str]) -> str:
    """Say what was added, how far the error falls with it, and what is claimed of each term."""
    told = [f"{base.rpartition('.')[2]} {lacking(effects)}.", error_change(errors, units)]
    told += [text for e in effects for text in (cross_validated(e, e.id), claimed(e, e.id))]
    return " ".join(filter(None, told))
