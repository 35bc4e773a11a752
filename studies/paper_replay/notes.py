"""What the replay shows, in sentences: each stands on numbers of this run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from aero_bayes.simulation import Outcome
from paper_replay.descent import Descent, Slope
from paper_replay.facts import Facts
from paper_replay.published import BOX, FMINCON, PSO, PSO_DATASHEET, TABLE_1, UNOPTIMISED
from paper_replay.result import PAPER, RERUN, SCALED

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def write_notes(facts: Facts, outcomes: Mapping[Outcome, int]) -> tuple[str, ...]:
    """Write all sentences, in reading order."""
    return (
        *_comparison(facts),
        *_units(facts),
        *_heavy_rotor(facts),
        *_swarm(facts),
        *_search(facts),
        *_pitch_alone(facts),
        *_identifiable(facts),
        *_law(facts),
        *_failures(Counter(outcomes)),
    )


def number(value: float, digits: int = 3) -> str:
    """Write a number with significant digits, without an exponent where that reads well."""
    if value == 0.0 or not np.isfinite(value):
        return f"{value:g}"
    mantissa, power = f"{value:.{digits - 1}e}".split("e")
    exponent = int(power)
    if -4 < exponent < 6:
        text = f"{float(f'{mantissa}e{power}'):.{max(digits - 1 - exponent, 0)}f}"
        return text.rstrip("0").rstrip(".") if "." in text else text
    lead = mantissa.rstrip("0").rstrip(".") if "." in mantissa else mantissa
    return f"{lead}×10{str(exponent).translate(_RAISED)}"


def _comparison(facts: Facts) -> Iterator[str]:
    yield (
        "The recording here is simulated; the paper's is not public. Eq. 6 sums squares over samples (here "
        f"{facts.samples} at {number(facts.rate_hz)} Hz), so a fitness here and one in the paper are not the same "
        "quantity: only the order of the models can be compared."
    )
    here = sorted(
        (row for row in facts.rows if row.paper_fitness is not None and row.fitness is not None),
        key=lambda row: row.fitness or 0.0,
    )
    paper = sorted(TABLE_1, key=lambda one: one.fitness)
    yield (
        f"Best first, the paper's order is {_list([one.label for one in paper])}. The same parameters on this bench: "
        f"{_list([row.model for row in here])}."
    )


def _units(facts: Facts) -> Iterator[str]:
    k_t = UNOPTIMISED.parameters["k_t"]
    square, straight, seen = facts.quadratic, facts.linear, facts.measured
    yield (
        "Table 1 gives `k_t` and `k_d` in the units of a linear law; Eqs. 4 and 5 are quadratic. Read as quadratic, "
        f"the data-sheet values hold the rotor at {number(square['omega_m'])} rad/s at 24 V and pitch the body by "
        f"{number(square['theta'])} rad; read as linear, {number(straight['omega_m'])} rad/s and "
        f"{number(straight['theta'])} rad. The bench shows {number(seen['omega_m'])} rad/s and "
        f"{number(seen['theta'])} rad, so the table's numbers are used with the linear law."
    )
    fitted = facts.details.linear.value("k_t")
    yield (
        f"Even so `k_t` = {number(k_t)} N·s/rad is {number(k_t / fitted, 2)} times what this bench asks for "
        f"({number(fitted)} N·s/rad). The paper does not print its body's stiffness and arm, so its thrust cannot be "
        "checked against its own bench."
    )
    yield (
        f"`k_d` = {number(UNOPTIMISED.parameters['k_d'])} is negative in Table 1, as a load on the rotor. Our drag "
        f"torque opposes the rotation by itself, so it enters as {number(UNOPTIMISED.model_values['k_d'])} N·m·s/rad."
    )


def _heavy_rotor(facts: Facts) -> Iterator[str]:
    first, second = facts.peak[PSO.label], facts.peak[PSO_DATASHEET.label]
    yield (
        f"A rotor of {number(PSO.parameters['J_r'])} kg·m² does not start: in 20 s at 24 V it reaches "
        f"{number(first['omega_m'])} rad/s, or {number(second['omega_m'])} rad/s with the data-sheet `R_a`, and the "
        f"pitch stays below {number(max(first['theta'], second['theta']))} rad. Both models must then cost what a body "
        f"that never moves costs: {number(facts.fitness(PSO.label, PAPER))} and "
        f"{number(facts.fitness(PSO_DATASHEET.label, PAPER))} here, against {number(facts.still)}. The paper prints "
        f"{number(PSO.fitness)} and {number(PSO_DATASHEET.fitness)}: with this inertia Eqs. 1 to 5 cannot give both."
    )


def _swarm(facts: Facts) -> Iterator[str]:
    details, (light, heavy), edge = facts.details, facts.speed_cost, BOX["J_r"][1]
    whole = details.quadratic.value("J_r") + details.visibility.values["J_s"]
    median, largest = np.median(details.endings, axis=0), np.max(details.endings, axis=0)
    yield (
        f"How 84 kg·m² can come out: the axis is linear. Of 0 to {number(edge)} kg·m² a share of "
        f"{number(1e-4 / edge)} lies below 10⁻⁴ kg·m², where the rotor is ({number(whole)}). From 1 to "
        f"{number(edge)} kg·m² the speed's Eq. 6 changes by {number(100 * abs(heavy - light) / heavy, 2)} %: a rotor "
        "that does not start is equally wrong at "
        "any inertia."
    )
    spoilt = details.swarm[1].cost / details.swarm[1].start_cost
    yield (
        f"Eight particles, rerun with {len(details.endings)} seeds, had their best `J_r` + `J_s` at "
        f"{number(median[0])} kg·m² after the first iteration (median; largest {number(largest[0])}), "
        f"{number(median[4])} after 5 and {number(median[-1])} after {median.size}, still "
        f"{number(median[-1] / whole, 2)} times the rotor's. In the run of the table the speed's Eq. 6 ended "
        f"{number(spoilt, 2)} times that of the data sheet, which the swarm was not shown."
    )
    scaled = details.swarm_scaled[1]
    yield (
        "On logarithmic axes the same eight particles and iterations end at "
        f"{number(scaled.values['J_r'] + scaled.values['J_s'])} kg·m², where the speed's Eq. 6 is "
        f"{number(scaled.cost / scaled.start_cost, 2)} times that of the data sheet."
    )


def _search(facts: Facts) -> Iterator[str]:
    electrical, mechanical, aerodynamic = facts.details.line_search
    interior, exact = facts.details.interior_point, facts.details.exact
    inertia, (r_a, l_a), (k_d, k_t) = mechanical.slopes[0], electrical.slopes, aerodynamic.slopes
    yield (
        f"RaPId's template asks fmincon for difference steps of 0.1: {number(inertia.step / inertia.value)} times "
        f"`J_r`. There the speed's Eq. 6 has a slope of {number(inertia.exact)}; the step sees "
        f"{number(inertia.coarse)}{_sign(inertia)}. Started at 8×10⁻⁶ kg·m², a line search ends at `J_r` + `J_s` = "
        f"{number(_inertia(mechanical))}, an interior-point method at {number(_inertia(interior[1]))}, exact slopes "
        f"on logarithmic axes at {number(_inertia(exact[1]))}."
    )
    moved = abs(l_a.value * r_a.coarse / l_a.coarse) if l_a.coarse else float("inf")
    won = 100 * (1 - exact[0].cost / electrical.start_cost)
    yield (
        f"How `R_a` and `L_a` can stay: along `L_a` the current's Eq. 6 has a slope of {number(l_a.exact)} per H; the "
        f"step of {number(l_a.step)} H sees {number(l_a.coarse)}{_sign(l_a)}. On unscaled axes this slope decides: by "
        f"the time `L_a` has moved by its own size, `R_a` has moved by {number(moved, 2)} Ω. {_stayed(electrical)} "
        f"There was little to win: the exact search lowers this stage's cost by {number(won, 2)} %."
    )
    drift = abs(k_t.value * k_d.coarse / k_t.coarse) if k_t.coarse else float("inf")
    yield (
        f"How `k_d` can stay: the step sees a slope of {number(k_t.coarse)} along `k_t` and {number(k_d.coarse)} along "
        f"`k_d` (exact: {number(k_t.exact)} and {number(k_d.exact)}). While a first step takes `k_t` through its "
        f"whole value, `k_d` moves by {number(100 * drift / k_d.value, 2)} % of itself."
    )
    yield (
        f"From these slopes a line search ends at a pitch fitness of {number(aerodynamic.cost)} (`k_t` = "
        f"{number(aerodynamic.values['k_t'])}, `k_d` = {number(aerodynamic.values['k_d'])}), an interior-point method "
        f"at {number(interior[2].cost)} (`k_t` = {number(interior[2].values['k_t'])}): where such a search ends is an "
        f"accident of the algorithm. Exact slopes on logarithmic axes end at {number(exact[2].cost)}."
    )
    taken = exact[0].values["L_a"]
    yield (
        f"The recipe has no input delay; this bench applies its voltage {number(1e3 * facts.delay)} ms late. Fitted "
        f"to the current alone, `L_a` becomes {number(1e3 * taken)} mH, "
        f"{number(taken / UNOPTIMISED.parameters['L_a'], 2)} times the data sheet, to imitate that."
    )


def _pitch_alone(facts: Facts) -> Iterator[str]:
    rerun, exact = (
        next(row for row in facts.rows if (row.model, row.variant) == (FMINCON.label, variant))
        for variant in (RERUN, SCALED)
    )
    if rerun.fitness is not None and exact.fitness is not None:
        yield (
            f"A small pitch fitness says little of the motor: the line search reaches {number(rerun.fitness)} with "
            f"a rotor speed that is wrong by {number(rerun.rms['omega_m'])} rad/s rms. Scaled axes do not cure that: "
            f"with `k_d` taken from the pitch alone, the exact search is off by {number(exact.rms['omega_m'])} rad/s; "
            f"fitted to all outputs at once, by {number(facts.details.linear.rms['omega_m'])} rad/s."
        )
    look = facts.details.visibility
    spread = {name: look.relative_sd(name, outputs=("theta",)) for name in ("R_a", "c_m", "J_r", "k_d", "k_t")}
    blind = [f"`{name}`" for name, value in spread.items() if value > 1.0]
    if blind:
        yield (
            f"From the pitch alone, with the motor's other parameters unknown, no method can give {', '.join(blind)} "
            "a standard deviation below 100 %."
        )


def _identifiable(facts: Facts) -> Iterator[str]:
    look, split = facts.details.visibility, FMINCON.parameters
    estimate = facts.details.quadratic.parameters["J_r"]
    spread = f" ± {number(estimate.sd, 2)}" if estimate.sd is not None else ""
    yield (
        "`J_r` and `J_s` act only as a sum: the directions of their sensitivities differ by "
        f"{number(look.alike('J_r', 'J_s'), 2)}, so one direction carries no information. The data gives `J_r` + "
        f"`J_s` = {number(estimate.value + look.values['J_s'])}{spread} kg·m²; the paper's split into "
        f"{number(split['J_r'])} and {number(split['J_s'])} is one of infinitely many."
    )
    rest = [name for name in look.names if name not in ("J_s", "L_a", "input_delay")]
    yield (
        "`L_a` is not visible at this rate: its time constant is "
        f"{number(1e3 * look.values['L_a'] / look.values['R_a'], 2)} ms, a sample takes {number(1e3 / look.rate_hz)} "
        f"ms. No method gets its standard deviation below {_percent(look.relative_sd('L_a'))} of the value "
        f"({_percent(look.relative_sd('L_a', rest))} if the input delay were known exactly)."
    )


def _law(facts: Facts) -> Iterator[str]:
    fits = {"linear": facts.details.linear, "quadratic": facts.details.quadratic}
    better, worse = sorted(fits, key=lambda law: -fits[law].log_likelihood)
    gain = fits[better].log_likelihood - fits[worse].log_likelihood
    errors = ", ".join(
        f"{text} {number(fits[better].rms[name])} against {number(fits[worse].rms[name])} {unit}"
        for name, unit, text in (("i_m", "A", "current"), ("omega_m", "rad/s", "speed"), ("theta", "rad", "pitch"))
    )
    yield (
        f"Which law: fitted to all outputs at once, the {better} law is ahead of the {worse} one by {number(gain)} in "
        f"log-likelihood. RMS errors: {errors}."
    )


def _failures(outcomes: Counter[Outcome]) -> Iterator[str]:
    failed = {outcome: count for outcome, count in outcomes.items() if outcome is not Outcome.OK and count}
    if failed:
        kinds = ", ".join(f"{outcome.text}: {count}" for outcome, count in sorted(failed.items()))
        yield (
            f"{sum(failed.values())} of {outcomes.total()} simulations failed ({kinds}), in the recipe's box, which "
            "lets an inertia or an inductance be zero; each counts as an infinite cost."
        )


def _inertia(end: Descent) -> float:
    return end.values["J_r"] + end.values["J_s"]


def _sign(slope: Slope) -> str:
    return ", the wrong sign" if slope.exact * slope.coarse < 0.0 else ""


def _stayed(end: Descent) -> str:
    moved = [
        f"`{slope.parameter}` = {number(end.values[slope.parameter])}"
        for slope in end.slopes
        if abs(end.values[slope.parameter] - slope.value) > 1e-3 * abs(slope.value)
    ]
    if moved:
        return f"The line search ended at {', '.join(moved)}."
    return "No step that way lowers the cost, and the line search leaves both at the data sheet, as the paper's did."


def _percent(share: float) -> str:
    return f"{number(100 * share, 2)} %" if np.isfinite(share) else "any bound"


def _list(items: Sequence[str]) -> str:
    return "; ".join(items)
