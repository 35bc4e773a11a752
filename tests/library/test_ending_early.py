"""Work that is asked to end gives what it has and says so: by a progress function, or by an interrupt in a notebook."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import pytest

import aero_bayes
from aero_bayes.progress import watching


def ends_at(phase: str, share: float) -> Any:
    """A progress function that asks the work to end from some point on."""
    return lambda what, done, *_: what.startswith(phase) and done >= share


def test_a_fit_that_is_ended_has_not_converged(cart: SimpleNamespace) -> None:
    found = aero_bayes.fit(
        cart.recording, cart.model, parameters=["k", "d"], workers=0, progress=ends_at("swarm", 0.02)
    )
    assert not found.reason.converged
    assert found.warnings == (found.reason.value,)
    assert found.diagnosis.first is not None
    assert found.diagnosis.first.cause == "search"  # not the model, whose residual says little before the end
    whole = cart.fit
    assert found.failures["completed"] < whole.failures["completed"]
    assert found.log_likelihood <= whole.log_likelihood + 1e-3


def test_a_posterior_that_is_ended_keeps_its_draws(cart: SimpleNamespace) -> None:
    found = aero_bayes.sample(cart.fit, workers=0, progress=ends_at("sampling", 0.6))
    assert not found.converged
    assert 8 <= found.steps < 16
    with pytest.raises(aero_bayes.CannotFinishError, match="interrupted"):
        aero_bayes.sample(cart.fit, workers=0, progress=ends_at("burn-in", 0.0))


def test_a_proposal_that_is_ended_is_the_best_so_far(cart: SimpleNamespace) -> None:
    ended, whole = (
        aero_bayes.propose_experiment(cart.fit, duration=4.0, workers=0, progress=progress)
        for progress in (ends_at("candidates", 0.0), None)
    )
    assert 1.0 < ended.gain < whole.gain


def test_a_loop_that_is_ended_names_nothing(cart: SimpleNamespace) -> None:
    settings = aero_bayes.LoopSettings(laws=("coulomb_friction",))
    found = aero_bayes.close_loop(
        cart.fit, cart.test, settings=settings, workers=0, progress=ends_at("trying each candidate", 0.0)
    )
    assert (found.outcome, found.effects) == ("unexplained", ())
    assert "interrupted" in found.sentence


@pytest.mark.parametrize("workers", [0, 2])
def test_the_share_of_a_loop_moves_with_its_work_and_never_falls(cart: SimpleNamespace, workers: int) -> None:
    told: list[float] = []
    settings = aero_bayes.LoopSettings(laws=("coulomb_friction", "gain", "offset", "delay"), max_effects=2)
    found = aero_bayes.close_loop(
        cart.fit, cart.test, settings=settings, workers=workers, progress=lambda what, share: told.append(share)
    )
    assert [e.id for e in found.effects] == ["coulomb_friction@v"]
    assert told == sorted(told)
    assert told[0] == 0.0
    assert told[-1] == 1.0
    assert len(set(told)) >= 20
    assert max(b - a for a, b in pairwise(told)) <= 0.5  # its search found one term of two


@pytest.fixture
def heard() -> Iterator[None]:
    """Interrupts are heard, also by what a shell in the background started, which ignores them."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("heard")
def test_the_first_interrupt_in_a_notebook_is_noted_and_the_second_acts(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: object()))
    before = signal.getsignal(signal.SIGINT)
    with watching(None) as watched:
        assert not watched("swarm", 0.1, 1.0)
        signal.raise_signal(signal.SIGINT)
        assert watched("swarm", 0.2, 1.0)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) == before
    assert "swarm" in capsys.readouterr().err


@pytest.mark.usefixtures("heard")
def test_outside_notebooks_an_interrupt_acts_at_once() -> None:
    with pytest.raises(KeyboardInterrupt), watching(None):
        signal.raise_signal(signal.SIGINT)


def test_a_loop_shows_its_page(loop: aero_bayes.LoopResult) -> None:
    shown = loop._repr_html_()
    assert shown.startswith("<table>")
    assert "coulomb_friction@v" in shown.partition("srcdoc=")[2]
