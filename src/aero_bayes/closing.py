"""What holds something that must be given back, and gives it back at the end of a ``with`` block."""

from __future__ import annotations

from types import TracebackType
from typing import Self


class ClosedAtExit:
    """A context manager that closes itself."""

    def close(self) -> None:
        """Give back what is held."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
