"""Progress of long work: what is done, how far it is, how long it will still take, and whether it is to end early."""

from __future__ import annotations

import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import Self

from tqdm import tqdm

#: Told what is done, how far it is (0 to 1) and perhaps a value, a number or words; it returns True to end the work
#: early. The one form of ``progress`` of all long work.
Progress = Callable[..., object]
RESOLUTION = 1000
#: Seconds between lines where nobody watches a bar, and after which the first says how long it will take.
LINE_EVERY, FIRST_AFTER = 15.0, 3.0
#: Seconds within which what is done was done before, by a run that this one resumes.
RESUMED_SECONDS = 0.5
_BAR = "{desc:<36.36}{percentage:3.0f}%|{bar:24}| {elapsed}{postfix}"
#: Share of a piece of work from which its end can be told, and how much longer than that it may take: what is told of
#: the time never rises.
TELLING_SHARE, MARGIN = 0.1, 1.3


def _in_notebook() -> bool:
    """Return whether this runs in IPython, in a Jupyter notebook for example."""
    ipython = sys.modules.get("IPython")
    return ipython is not None and ipython.get_ipython() is not None


class Watched:
    """Progress of work that may be asked to end with what it has."""

    def __init__(self, progress: Progress | None = None, interrupts: Sequence[int] = ()) -> None:
        self._progress, self._interrupts = progress, interrupts
        self._last: tuple[str, float] = ("", 0.0)
        self.asked_to_end = False

    def __call__(self, phase: str, share: float, *value: object) -> bool:
        if not phase.endswith("."):  # a sentence is told once
            self._last = phase, share
        if (self._progress is not None and self._progress(phase, share, *value) is True) or self._interrupts:
            self.asked_to_end = True
        return self.asked_to_end

    def again(self, *value: object) -> bool:
        """Tell the same phase and share once more."""
        return self(*self._last, *value)

    def ends_within(self, seconds: float) -> None:
        """Tell how long the work will still take at most, where that is known."""
        if isinstance(self._progress, ProgressBar | Piece):
            self._progress.ends_within(seconds)


@contextmanager
def watching(progress: Progress | None) -> Iterator[Watched]:
    """Tell ``progress`` of work. In a notebook it is a bar by default, and an interrupt asks the work to end."""
    if isinstance(progress, Watched) or not _in_notebook():
        yield progress if isinstance(progress, Watched) else Watched(progress)
        return
    with _interrupts() as seen, ProgressBar(quiet=False) as bar:
        yield Watched(progress if progress is not None else bar, seen)


@contextmanager
def _interrupts() -> Iterator[list[int]]:
    """Note the first interrupt only, the second one acts as always; outside the main thread all do."""
    seen: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield seen
        return
    before = signal.getsignal(signal.SIGINT)

    def note(number: int, frame: FrameType | None) -> None:
        seen.append(number)
        signal.signal(signal.SIGINT, before)
        print("interrupted: ends with what it has; interrupt again to drop it", file=sys.stderr, flush=True)

    signal.signal(signal.SIGINT, note)
    try:
        yield seen
    finally:
        signal.signal(signal.SIGINT, before)


class ProgressBar:
    """One bar a piece of work; called with its phase, how far it is (0 to 1), and what to show beside it.

    Phases with a common beginning before a colon (``loop: round 1``) are one piece of work. Where standard error is no
    terminal that can draw, a line a phase, and one now and then; where it is to be quiet, nothing."""

    def __init__(self, quiet: bool) -> None:
        self._quiet, self._process = quiet, os.getpid()
        self._total, self._limited = math.inf, False
        drawn = _in_notebook() or (sys.stderr.isatty() and os.environ.get("TERM") != "dumb")
        self._lines = not drawn
        self._phase, self._work = "", ""
        self._began = self._told = 0.0
        self._first = 0.0
        self._bar: tqdm[None] | None = None

    def __call__(self, phase: str, share: float, value: float | str = "") -> None:
        if self._quiet or os.getpid() != self._process:  # a copy of this process draws nothing
            return
        if phase.endswith("."):
            tqdm.write(phase, file=sys.stderr)
            return
        share = min(max(share, 0.0), 1.0)
        work = phase.partition(":")[0]
        if work != self._work:
            self.close()
            self._work, self._began, self._total, self._limited = work, time.monotonic(), math.inf, False
        if time.monotonic() - self._began < RESUMED_SECONDS:
            self._first = share
        beside = value if isinstance(value, str) else f"{value:.6g}"
        if self._lines:
            self._line(phase, share, beside)
        else:
            self._draw(phase, share, beside)
        self._phase = phase

    def ends_within(self, seconds: float) -> None:
        """Note how long this piece of work will still take at most, in place of what its speed tells."""
        total = time.monotonic() - self._began + seconds
        self._total, self._limited = min(self._total, total) if self._limited else total, True

    def _left(self, share: float) -> str:
        """Return how long it will still take at most; empty where that cannot be told, or is over."""
        spent, done = time.monotonic() - self._began, share - self._first
        if done > TELLING_SHARE and spent > FIRST_AFTER and not self._limited:
            self._total = min(self._total, spent * (1.0 + MARGIN * (1.0 - share) / done))
        left = self._total - spent
        return f"at most {left:.0f} s left" if 0.5 < left < math.inf and share < 1.0 else ""

    def _line(self, phase: str, share: float, beside: str) -> None:
        now, text = time.monotonic(), self._left(share)
        if phase != self._phase:
            print(f"{phase} ...{f' {text}' if text else ''}", file=sys.stderr, flush=True)
        elif now - self._told < LINE_EVERY:
            return
        else:
            words = f" ({beside})" if beside else ""
            until = f"{share:.0%} after {now - self._began:.0f} s{', ' if text else ''}{text}"
            print(f"{phase}: {until}{words}", file=sys.stderr, flush=True)
        self._told = now

    def _draw(self, phase: str, share: float, beside: str) -> None:
        if self._bar is None:
            at = round(share * RESOLUTION)
            self._bar = tqdm(total=RESOLUTION, initial=at, desc=phase, bar_format=_BAR, leave=not _in_notebook())
        self._bar.set_description_str(phase, refresh=False)
        self._bar.set_postfix_str(", ".join(filter(None, (self._left(share), beside))), refresh=False)
        self._bar.update(max(0, round(share * RESOLUTION) - self._bar.n))

    def close(self) -> None:
        """End the open bar at its present state."""
        if self._bar is not None:
            self._bar.close()
            self._bar = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        if error is None and self._bar is not None:
            self._bar.update(RESOLUTION - self._bar.n)
        self.close()


@dataclass(frozen=True)
class Piece:
    """A piece of work of a bar; its name stands before each phase."""

    bar: ProgressBar
    name: str

    def __call__(self, phase: str, share: float) -> None:
        self.bar(f"{self.name}: {phase}", share)

    def ends_within(self, seconds: float) -> None:
        """Note how long it will still take at most."""
        self.bar.ends_within(seconds)
