"""What holds something that must be given back, and gives it back at the end of a ``with`` block."""

from __future__ import annotations

from typing import Self


class ClosedAtExit:
    """A context manager that closes itself."""

    def close(self) -> None:
        """Give back what is held."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()
