"""The parts of a search that the page on extending it shows: they run on the cart, whose friction is still found."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from test_documentation import ROOT, blocks

from aero_bayes.data import Layout, read_recording
from aero_bayes.judge import ChoiceSettings, Chooser, Recordings
from aero_bayes.laws import CandidateFilter, LawPlaces, ModelicaFamily
from aero_bayes.loop import LoopContext, LoopSettings, LoopStatistics, fit_base_model
from aero_bayes.search import (
    FitNoise,
    Library,
    ModelCache,
    ModelSource,
    Parts,
    SearchResult,
    Structure,
    StructureSearch,
)
from aero_bayes.simulation import WorkerPool

CART = ROOT / "examples" / "cart"


@pytest.fixture(scope="module")
def page() -> dict[str, Any]:
    """What the blocks of the page define, run one after the other."""
    names: dict[str, Any] = {}
    exec("\n".join(blocks("docs/howto/extend_the_search.md", "python")), names)
    return names


@contextmanager
def searched(settings: LoopSettings, parts: Parts, folder: Path) -> Iterator[tuple[StructureSearch, SearchResult]]:
    """A search on the cart with these parts, as the loop runs its own."""
    recording = read_recording(CART / "train.csv", layout=Layout.of(["F"], ["position"]))
    family = ModelicaFamily(
        LawPlaces("Rig", (CART / "Rig.mo",), candidate_filter=CandidateFilter(laws=settings.laws)), folder
    )
    recordings = Recordings.of([recording], [], settings.held_out, ["position"])
    with WorkerPool(0) as pool:
        context = LoopContext(family, recordings, settings, pool, folder, lambda *told: None, LoopStatistics())
        base = fit_base_model(context)
        family.prepare(base.plain, base.fit, context.open)
        library = Library(family.candidate_groups(), family.refinements(), tuple(family.curves()))
        source = ModelSource(family, base.plain, base.fit.free, context.open_objective, context.open, False)
        cache = ModelCache(source)
        model = cache.of(Structure(), library.groups[0])
        fit = replace(settings.local_fit, floors=base.plain.data.floors, hold_noise=True)
        root = model.fit(Structure(), model.coordinates_of(base.values, ()), FitNoise(base.fit.noise), fit)
        searching = StructureSearch(cache, library, settings.structures, fit, base.floors, parts)
        yield searching, searching.run(root)
        cache.close()


def counting(kind: type, method: str, calls: Counter[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Count what a method gives, by the name of its class."""
    plain = getattr(kind, method)

    def counted(self: object, *given: object) -> object:
        found = plain(self, *given)
        found = list(found) if isinstance(found, Iterator) else found
        calls[kind.__name__] += len(found) if isinstance(found, list) else 1
        return found

    monkeypatch.setattr(kind, method, counted)


def test_parts_of_ones_own_run_beside_the_standard_ones(
    page: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    calls: Counter[str] = Counter()
    for name, method in (
        ("SwapAtPort", "neighbours"), ("RandomSizes", "starts"), ("Jump", "refit"),
    ):  # fmt: skip
        counting(page[name], method, calls, monkeypatch)
    with searched(page["settings"], page["parts"], tmp_path) as (searching, explored):
        choice = Chooser(ChoiceSettings(), searching.fit_settings, searching.complete, searching.alone).choose(explored)
    assert choice.fitted.terms == ("coulomb_friction@v",)
    assert set(+calls) == {"SwapAtPort", "RandomSizes", "Jump"}


def test_what_a_loop_leaves_out_is_not_among_its_parts(page: dict[str, Any]):
    settings = page["settings"]
    parts = Parts.of(settings.leave_out)
    names = {type(part).__name__ for part in (*parts.edits, *(restart for restart, _ in parts.restarts))}
    assert {"DropTerm", "AddTerm", "DeclaredValues"} <= names
    assert not names & {"AddPair", "GrowingHorizon"}
