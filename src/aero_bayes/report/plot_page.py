"""The page of a closed loop as text, for a notebook."""

from __future__ import annotations

from aero_bayes.files import ScratchFolder
from aero_bayes.loop.result import LoopResult


def loop_page(loop: LoopResult) -> str:
    """Return the page of a loop: HTML that loads nothing from elsewhere."""
    from aero_bayes.commands.commands import write_folder

    with ScratchFolder() as scratch:
        return write_folder(loop, scratch / "loop").read_text("utf-8")
