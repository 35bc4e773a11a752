"""Everything public is documented: what it takes, what it gives, in which units, with examples that run."""

from __future__ import annotations

import contextlib
import doctest
import re
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import aero_bayes
from aero_bayes.data import Layout
from aero_bayes.estimate import ParameterSpec, parameters_from_model

sys.path.insert(0, str(Path(__file__).parents[2] / "docs"))
from docstrings import Public, public

EVERYTHING = list(public())
FLAGS = doctest.ELLIPSIS | doctest.IGNORE_EXCEPTION_DETAIL


def named(items: list[Public]) -> Any:
    return pytest.mark.parametrize("item", items, ids=[item.name for item in items])


@named(EVERYTHING)
def test_every_parameter_is_described(item: Public):
    assert item.doc.text, "no docstring"
    described = {name for names, _, _ in item.doc.entries("Parameters") for name in names}
    if item.owner is None:
        assert set(item.parameters) - described == set()
    else:  # a member of few parameters may name them in its sentence
        words = set(re.findall(r"\w+", item.doc.text))
        assert set(item.parameters) - described - words == set()
    assert described - set(item.parameters) == set(), "described, but not there"


@named(EVERYTHING)
def test_everything_is_shown_in_an_example(item: Public):
    """A function or class in its own; a member in its own, or in its class's."""
    if item.owner is None:
        assert ">>>" in item.doc.sections.get("Examples", "")
        return
    shown = item.doc.sections.get("Examples", "")
    shown += Public(item.owner.__name__, item.owner).doc.sections.get("Examples", "")
    assert re.search(rf"\.{item.name.rpartition('.')[2]}\b", shown)


@named([item for item in EVERYTHING if "Examples" in item.doc.sections])
def test_examples_print_what_they_say(item: Public, examples: dict[str, Any], cart: SimpleNamespace):
    test = doctest.DocTestParser().get_doctest(item.doc.sections["Examples"], dict(examples), item.name, None, 0)
    said: list[str] = []
    with contextlib.chdir(cart.folder):
        doctest.DocTestRunner(optionflags=FLAGS).run(test, out=said.append)
    assert not said, "".join(said)


@pytest.fixture(scope="session")
def examples(
    cart: SimpleNamespace, posterior: aero_bayes.Posterior, loop: aero_bayes.LoopResult, run: aero_bayes.RunDirectory
) -> dict[str, Any]:
    """The names that examples take for granted; the reference says what they are."""
    return {
        "aero_bayes": aero_bayes, "np": np, "Path": Path, "Layout": Layout, "ParameterSpec": ParameterSpec,
        "parameters_from_model": parameters_from_model, "model": cart.model, "recording": cart.recording,
        "test": cart.test, "free": cart.free, "fit": cart.fit, "posterior": posterior, "loop": loop, "run": run,
    }  # fmt: skip
