"""What compilers made is kept by what it was made from."""

from __future__ import annotations

from pathlib import Path

import pytest

from aero_bayes import files
from aero_bayes.files import make_once


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path


class Compiler:
    """Counts its calls; its product tells the call."""

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self) -> bytes:
        self.calls += 1
        return bytes([self.calls])


def test_same_ingredients_are_compiled_once():
    compiler = Compiler()
    assert [make_once("a.so", (b"x", b"y"), compiler) for _ in range(3)] == [b"\x01"] * 3
    assert compiler.calls == 1


def test_ingredients_are_kept_apart():
    compiler = Compiler()
    assert make_once("a.so", (b"xy", b""), compiler) != make_once("a.so", (b"x", b"y"), compiler)


def test_a_failure_is_not_kept():
    def fail() -> bytes:
        raise ValueError

    with pytest.raises(ValueError):  # noqa: PT011
        make_once("a.so", (b"x",), fail)
    assert make_once("a.so", (b"x",), Compiler()) == b"\x01"


def test_a_cache_that_cannot_be_written_does_no_harm(cache):
    (cache / "aero-bayes").write_text("a file where the folder should be")
    assert make_once("a.so", (b"x",), Compiler()) == b"\x01"


def test_the_oldest_are_removed(cache, monkeypatch):
    monkeypatch.setattr(files, "MAX_BYTES", 10_000)
    for k in range(20):
        make_once("a.so", (bytes([k]),), lambda: bytes(1000))
    sizes = [file.stat().st_size for file in (cache / "aero-bayes" / "made").iterdir()]
    assert 5_000 <= sum(sizes) <= 10_000
