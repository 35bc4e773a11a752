"""Messages are tested by the facts they state, not by their wording."""

from __future__ import annotations

import re


def facts(*stated: str) -> str:
    """A regular expression for texts that state all of these, as whole words, in any order."""
    return "(?s)" + "".join(f"(?=.*{_whole(text)})" for text in stated)


def _whole(text: str) -> str:
    before = r"(?<!\w)" if re.match(r"\w", text) else ""
    after = r"(?!\w)" if re.search(r"\w$", text) else ""
    return before + re.escape(text) + after
