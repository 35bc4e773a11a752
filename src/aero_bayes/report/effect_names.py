"""Effects of the catalogue as a person says them, with their id for who wants to look them up."""

from __future__ import annotations

import re

from markupsafe import Markup, escape

from aero_bayes.export import CATALOGUE

_IDS = re.compile(rf"(?<!\w)({'|'.join(CATALOGUE)})(?!\w)")


def effect_words(id_: str) -> str:
    """What an effect is; nothing for one that is not in the catalogue."""
    if id_ == "free_form":
        return "a shape learned from the data"
    return CATALOGUE[id_].summary if id_ in CATALOGUE else ""


def named_effect(id_: str) -> Markup:
    """``dry friction at the pivot (pivot_coulomb_friction)``, the id set as code."""
    words = effect_words(id_)
    code = Markup("<code>{}</code>").format(id_)
    return Markup("{} ({})").format(words, code) if words else code


def with_named_effects(text: str) -> Markup:
    """Escaped text in which every id of the catalogue is put in words."""
    parts = _IDS.split(text)
    return Markup("").join(named_effect(part) if index % 2 else escape(part) for index, part in enumerate(parts))
