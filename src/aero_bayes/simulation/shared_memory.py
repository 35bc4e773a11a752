"""The block of memory that a pool shares with its worker processes."""

from __future__ import annotations

import mmap
import os
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

SLOT_BYTES = 64  # a cache line, so that workers do not slow each other down
_FIRST_SIZE = 1 << 20


class SharedMemory:
    """A slot for each worker, in which it says what it is doing, and behind them a job with its values and results."""

    def __init__(self, slots: int, folder: Path) -> None:
        self._count = slots
        if hasattr(os, "memfd_create"):
            self.fd = os.memfd_create("aero-bayes")
        else:
            with tempfile.TemporaryFile(dir=folder) as stream:
                self.fd = os.dup(stream.fileno())
        self._map(_FIRST_SIZE)

    def _map(self, size: int) -> None:
        os.ftruncate(self.fd, size)
        self.data: NDArray[np.uint8] = np.frombuffer(mmap.mmap(self.fd, size), dtype=np.uint8)
        self.slots = self.data[: self._count * SLOT_BYTES].view(np.int64).reshape(-1, SLOT_BYTES // 8)

    def reserve(self, size: int) -> int:
        """Offset in bytes behind which there is room for `size` bytes; grows to the next power of two."""
        start = self._count * SLOT_BYTES
        if start + size > self.data.size:
            self._map(1 << (start + size - 1).bit_length())
        return start
