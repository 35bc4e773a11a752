"""What the replay shows, in sentences: each stands on numbers of this run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import partial

import numpy as np

from aero_bayes.report.text import tidy
from aero_bayes.simulation import Outcome
from paper_replay.published import BOX, FMINCON, PSO, PSO_DATASHEET, TABLE_1, UNOPTIMISED
from paper_replay.result import PAPER, RERUN, SCALED, Details, ReplayRow, row_of
from paper_replay.search import Slope, StageEnd

#: Numbers in sentences have three digits.
number = partial(tidy, digits=3)


def write_notes(rows: Sequence[ReplayRow], details: Details, outcomes: Counter[Outcome]) -> tuple[str, ...]:
    """Write all sentences, in reading order."""
    return (*_comparison(rows, details), *_swarm(details), *_search(details), *_data(rows, details),
            *_failures(outcomes))  # fmt: skip


def _comparison(rows: Sequence[ReplayRow], details: Details) -> Iterator[str]:
    here = sorted((row for row in rows if row.paper_fitness and row.fitness), key=lambda row: row.fitness or 0.0)
    paper = "; ".join(one.label for one in sorted(TABLE_1, key=lambda one: one.fitness))
    yield (
        "The recording here is simulated; the paper's is not public. Eq. 6 sums squares over samples, so only the "
        f"order of the models can be compared. Best first, the paper's order of the {len(TABLE_1)} models is {paper}. "
        f"The same parameters on this bench: {'; '.join(row.model for row in here)}."
    )
    excess = UNOPTIMISED.parameters["k_t"] / details.linear["k_t"].value
    yield (
        "Table 1 gives `k_t` and `k_d` in the units of a linear law, so they are used with it; Eqs. 4 and 5 are "
        f"quadratic. `k_d` = {number(UNOPTIMISED.parameters['k_d'])} is negative there, as a load on the rotor; our "
        f"drag torque opposes the rotation by itself. `k_t` is {number(excess, digits=2)} "
        "times what this bench asks for."
    )
    first, second = (row_of(rows, one.label, PAPER).fitness or np.nan for one in (PSO, PSO_DATASHEET))
    yield (
        f"A rotor of {number(PSO.parameters['J_r'])} kg·m² does not start, so both swarm models must cost what a body "
        f"that never moves costs: {number(first)} and {number(second)} here, against {number(details.still)}. The "
        f"paper prints {number(PSO.fitness)} and {number(PSO_DATASHEET.fitness)}: with this inertia Eqs. 1 to 5 cannot "
        "give both."
    )


def _swarm(details: Details) -> Iterator[str]:
    edge, scaled = BOX["J_r"][1], details.swarm_scaled[1]
    whole = details.quadratic["J_r"].value + UNOPTIMISED.parameters["J_s"]
    median, largest = np.median(details.endings, axis=0), np.max(details.endings, axis=0)
    yield (
        f"How 84 kg·m² can come out: the axis is linear. Of 0 to {number(edge)} kg·m² a share of {number(1e-4 / edge)} "
        f"lies below 10⁻⁴ kg·m², where the rotor is ({number(whole)}). Eight particles, rerun with "
        f"{len(details.endings)} seeds, had their best `J_r` + `J_s` at {number(median[0])} kg·m² after the first "
        f"iteration (median; largest {number(largest[0])}) and at {number(median[-1])} after {median.size}. On "
        f"logarithmic axes they end at {number(_inertia(scaled.values))} kg·m², where the speed's Eq. 6 is "
        f"{number(scaled.cost / scaled.start_cost, digits=2)} times that of the data sheet."
    )


def _search(details: Details) -> Iterator[str]:
    electrical, mechanical, aerodynamic = details.line_search
    interior, exact = details.interior_point, details.exact
    inertia, l_a, (k_d, k_t) = mechanical.slopes[0], electrical.slopes[1], aerodynamic.slopes
    yield (
        f"RaPId's template asks fmincon for difference steps of 0.1: {number(inertia.step / inertia.value)} times "
        f"`J_r`. There the speed's Eq. 6 has a slope of {number(inertia.exact)}; the step sees "
        f"{number(inertia.coarse)}{_sign(inertia)}. A line search ends at `J_r` + `J_s` = "
        f"{number(_inertia(mechanical.values))}, an interior-point method at {number(_inertia(interior[1].values))}, "
        f"exact slopes on logarithmic axes at {number(_inertia(exact[1].values))}."
    )
    won = 100 * (1 - exact[0].cost / electrical.start_cost)
    yield (
        f"How `R_a` and `L_a` can stay: along `L_a` the current's Eq. 6 has a slope of {number(l_a.exact)} per H; the "
        f"step of {number(l_a.step)} H sees {number(l_a.coarse)}{_sign(l_a)}. {_stayed(electrical)} There was little "
        f"to win: the exact search lowers this stage's cost by {number(won, digits=2)} %."
    )
    yield (
        f"The step sees a slope of {number(k_t.coarse)} along `k_t` and {number(k_d.coarse)} along `k_d` (exact: "
        f"{number(k_t.exact)} and {number(k_d.exact)}). A line search ends at a pitch fitness of "
        f"{number(aerodynamic.cost)}, an interior-point method at {number(interior[2].cost)}, exact slopes on "
        f"logarithmic axes at {number(exact[2].cost)}."
    )


def _data(rows: Sequence[ReplayRow], details: Details) -> Iterator[str]:
    rerun, exact = (row_of(rows, FMINCON.label, variant) for variant in (RERUN, SCALED))
    speed = details.linear.rms["omega_m"]
    if rerun.fitness is not None and exact.fitness is not None:
        yield (
            f"A small pitch fitness says little of the motor: the line search reaches {number(rerun.fitness)} with a "
            f"rotor speed that is wrong by {number(rerun.rms['omega_m'])} rad/s rms, the exact search by "
            f"{number(exact.rms['omega_m'])} rad/s; the fit to all outputs at once by {number(speed)} rad/s."
        )
    gain = details.quadratic.log_likelihood - details.linear.log_likelihood
    yield f"Fitted to all outputs at once, the quadratic law's log-likelihood is {number(gain)} above the linear one's."


def _failures(outcomes: Counter[Outcome]) -> Iterator[str]:
    failed = {outcome: count for outcome, count in outcomes.items() if outcome is not Outcome.OK and count}
    if failed:
        kinds = ", ".join(f"{outcome.text}: {count}" for outcome, count in sorted(failed.items()))
        yield (
            f"{sum(failed.values())} of {outcomes.total()} simulations failed ({kinds}), in the recipe's box, which "
            "lets an inertia or an inductance be zero; each counts as an infinite cost."
        )


def _inertia(values: Mapping[str, float]) -> float:
    return values["J_r"] + values["J_s"]


def _sign(slope: Slope) -> str:
    return ", the wrong sign" if slope.exact * slope.coarse < 0.0 else ""


def _stayed(end: StageEnd) -> str:
    moved = [
        f"`{slope.parameter}` = {number(end.values[slope.parameter])}"
        for slope in end.slopes
        if abs(end.values[slope.parameter] - slope.value) > 1e-3 * abs(slope.value)
    ]
    if moved:
        return f"The line search ended at {', '.join(moved)}."
    return "No step that way lowers the cost, and the line search leaves both at the data sheet, as the paper's did."
