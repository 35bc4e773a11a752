"""Progress of long work, on standard error where someone is looking."""

from __future__ import annotations

import sys
from types import TracebackType
from typing import Self

from tqdm import tqdm

RESOLUTION = 1000


class ProgressBar:
    """One bar a phase; called with the phase's name, how far it is (0 to 1), and a number to show beside it."""

    def __init__(self, quiet: bool) -> None:
        self._quiet = quiet or not sys.stderr.isatty()
        self._phase = ""
        self._bar: tqdm[None] | None = None

    def __call__(self, phase: str, share: float, value: float | str = "") -> None:
        if self._quiet:
            if phase != self._phase:
                self._phase = phase
                print(f"{phase} ...", file=sys.stderr, flush=True)
            return
        if phase != self._phase or self._bar is None:
            self.close()
            self._phase = phase
            self._bar = tqdm(
                total=RESOLUTION, desc=phase, bar_format="{desc:<24}{percentage:3.0f}%|{bar:30}| {elapsed}{postfix}"
            )
        self._bar.update(max(0, round(min(share, 1.0) * RESOLUTION) - self._bar.n))
        self._bar.set_postfix_str(value if isinstance(value, str) else f"{value:.6g}", refresh=False)

    def close(self) -> None:
        """End the bar that is open."""
        if self._bar is not None:
            self._bar.update(RESOLUTION - self._bar.n)
            self._bar.close()
            self._bar = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
