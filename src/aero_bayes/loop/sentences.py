"""Sentences on what a loop found, for the page, the terminal and a notebook."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from aero_bayes.display import join_names
from aero_bayes.estimate.error_sentences import error_change
from aero_bayes.loop.extend import Alternative, FoundEffect

#: Alternatives that are listed by name, and those from which on an effect is not told at all.
MAX_NAMED, MAX_TOLD = 3, 5
_COUNTS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")


def lacking(effects: Sequence[FoundEffect]) -> str:
    """Say what the model lacks, as far as the data say it, and with what it was extended as required."""
    asked = [e.id for e in effects if e.claim is None]
    found = [e for e in effects if e.claim is not None]
    if len(found) > 1 and any(e.claim == "one of" for e in found):
        sure = [_what(e) for e in found if e.claim != "one of"]
        count = len(found) - len(sure)
        more = f"{_number(count)} {'more ' if sure else ''}{'effect' if count == 1 else 'effects'}"
        told = f"lacks {join_names([*sure, more])}"
    else:
        told = f"lacks {join_names([_what(e) for e in found])}" if found else ""
    return " and ".join(filter(None, (told, f"has {join_names(asked)}, as required" if asked else "")))


def _what(effect: FoundEffect) -> str:
    others = len(effect.alternatives)
    what = in_words(effect) or str(effect.id)
    if effect.claim == "one of" and others:
        told = f"one of {_number(1 + others)} effects" if others <= MAX_TOLD else "an effect that the data do not tell"
        return f"{told}, such as {what}"
    if effect.kind == "free_form" or effect.claim == "place":
        return f"an effect at {effect.port}"
    return f"{what} ({places(effect)})" if effect.claim == "mechanism" else what


def places(effect: FoundEffect) -> str:
    """Return the places at which a law does as well."""
    return "at " + join_names(list(dict.fromkeys([effect.port, *(one.port for one in effect.alternatives)])), "or")


def in_words(effect: FoundEffect) -> str:
    """Return what an effect is, without the note on its place; empty where no words are known."""
    return re.sub(r" \([^()]*\)$", "", effect.summary)


def _number(count: int) -> str:
    """Return a small whole number as a word."""
    return _COUNTS[count] if count < len(_COUNTS) else str(count)


def cross_validated(effect: FoundEffect, name: str, beside: Sequence[str] = ()) -> str:
    """Say how far an effect lowers the error on readings that were left out of the fit; ``name`` is what it is called.

    The error is that of the model with the effects ``beside`` it. Empty where that is not known."""
    if math.isnan(effect.share):
        return ""
    verb, change = ("raises", effect.share - 1.0) if effect.share > 1.0 else ("lowers", 1.0 - effect.share)
    spread = f" ± {100.0 * effect.share_sd:.0f}" if effect.share_sd >= 0.005 else ""
    of = f" of {effect.share_of}" if effect.share_of else ""
    rest = f" beside {join_names(beside)}" if beside else ""
    return f"Cross-validated on training, {name} {verb} the error{of}{rest} by {100.0 * change:.0f}{spread} %."


def claimed(effect: FoundEffect, name: str, others: str = "") -> str:
    """Say how sure it is that the effect is this one; empty for one that the configuration requires.

    ``others`` stands for what the data do not tell from it where that is listed elsewhere."""
    known = list(effect.alternatives)
    if effect.claim is None:
        return ""
    if effect.claim == "law":
        if known:
            near = f"the same law with more parameters or as a curve comes near ({others or _listed(known)})"
            return f"No other law that was tried does as well as {name}; only {near}{_less(known)}."
        return f"Nothing else that was tried does as well as {name}."
    late = "" if effect.tried_all else "What else may be in its place was not all tried."
    if len(known) > MAX_TOLD and effect.claim == "one of":
        told = f"The data do not tell which effect it is: {_number(len(known))} others do as well, {_how_near(known)}."
        return f"{told} {late}".strip()
    told = f"The data do not tell {name} from {others or _listed(known)}: {_how_near(known)}." if known else ""
    told = told or (
        f"No law of the library does as well as {name}, a curve that was learned from the data."
        if effect.kind == "free_form" else ""
    )  # fmt: skip
    like = f"It looks like {effect.looks_like}." if effect.kind == "free_form" and effect.looks_like else ""
    what = {
        "place": "The place is known, the law is not.",
        "mechanism": f"The law is known, its place is not: it acts {places(effect)}.",
    }.get(effect.claim, "")
    return " ".join(filter(None, (told, like, what, late)))


def _listed(known: Sequence[Alternative]) -> str:
    ids = [one.id for one in known]
    if len(ids) > MAX_NAMED:
        ids = [*ids[: MAX_NAMED - 1], f"{len(ids) - MAX_NAMED + 1} more"]
    return join_names(ids)


def _how_near(others: Sequence[Alternative]) -> str:
    """Say how much worse than the chosen term the worst of those predicts that the data do not tell from it."""
    them, ratios = others[0].id if len(others) == 1 else "them", [_known(one.error_ratio) for one in others]
    least, most = larger(min(ratios)), larger(max(ratios))
    told = f"from {least} to {most}" if "smaller" in least else f"at most {most}"
    return f"with {them} the error on left-out and validation readings is {most if least == most else told}"


def larger(ratio: float) -> str:
    """Return by how much an error is larger or smaller, in whole per cent."""
    size = f"{100.0 * abs(_known(ratio) - 1.0):.0f}"
    return f"{size} % {'larger' if ratio > 1.0 else 'smaller'}" if size != "0" else "the same"


def _known(ratio: float) -> float:
    """Return a ratio; one for a ratio that is not known."""
    return ratio if math.isfinite(ratio) else 1.0


def _less(known: Sequence[Alternative]) -> str:
    """Say how much smaller the error is with finer forms of a law, which are not chosen for that."""
    least = larger(min(_known(one.error_ratio) for one in known))
    return f", with an error up to {least}, too little for more parameters" if "smaller" in least else ""


def extended_sentence(
    base: str, effects: Sequence[FoundEffect], errors: Sequence[Any], units: Mapping[str, str]
) -> str:
    """Say what was added, how far the error falls with it, and what is claimed of each term."""
    told = [f"{base.rpartition('.')[2]} {lacking(effects)}.", error_change(errors, units)]
    told += [text for e in effects for text in (cross_validated(e, e.id, beside(effects, e)), claimed(e, e.id))]
    return " ".join(filter(None, told))


def beside(effects: Sequence[FoundEffect], effect: FoundEffect) -> list[str]:
    """Return the ids of the other effects, beside which one effect was cross-validated."""
    return [e.id for e in effects if e.id != effect.id]
