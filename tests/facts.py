"""Messages are tested by the facts they state, not by their wording."""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest

from aero_bayes.errors import InputError


def facts(*stated: str) -> str:
    """A regular expression for texts that state all of these, as whole words, in any order."""
    return "(?s)" + "".join(f"(?=.*{_whole(text)})" for text in stated)


def _whole(text: str) -> str:
    before = r"(?<!\w)" if re.match(r"\w", text) else ""
    after = r"(?!\w)" if re.search(r"\w$", text) else ""
    return before + re.escape(text) + after


def refusal(call: Callable[[], object], *stated: str) -> str:
    """The one line in which bad input is refused, which states all of these."""
    with pytest.raises(InputError) as caught:
        call()
    message = str(caught.value)
    assert "\n" not in message
    for text in stated:
        assert text in message, message
    return message
