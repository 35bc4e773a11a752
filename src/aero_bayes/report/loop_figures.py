"""Figures of the closed loop and of the paper's replay."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from markupsafe import Markup

from aero_bayes.report.drawing import Band, Dots, Line, Panel, Plate, cloud, draw, line
from aero_bayes.report.residual_figures import noise_floor, residuals
from aero_bayes.report.run_directory import FloatArray, RunDirectory, mapping, number, table
from aero_bayes.report.series_figures import NARROW, WIDE, columns_for, largest, named, unit_of
from aero_bayes.report.svg import ACCENT, INK, MEASURED, SERIES, WARM
from aero_bayes.report.text import plain_name, scaled_unit, signal_title

PORT = 430.0
#: States that a port's signal is drawn against: those that explain it best.
STATES_SHOWN = 2
_PORT_UNITS = {"electrical": "V", "rotor": "N.m", "thrust": "N", "body": "N.m"}


def before_and_after(run: RunDirectory, recording: str) -> Plate | None:
    """Residuals of the base model and of the extended model on one scale, output by output."""
    before, after = residuals(run, recording, "before"), residuals(run, recording, "after")
    outputs = [name for name in (before or after) if np.isfinite((before or after)[name]).any()]
    time = run.time(recording)
    if not outputs or len(time) < 2:
        return None

    def panels(width: float) -> list[Panel]:
        drawn = []
        for name in outputs:
            pair = [(before.get(name), WARM, 0.25), (after.get(name), ACCENT, 0.55)]
            factor, unit = scaled_unit(largest(before.get(name), after.get(name)), unit_of(run, name))
            floor = noise_floor(run, recording, name)
            levels = () if floor is None else (-2 * floor * factor, 2 * floor * factor)
            curves = tuple(
                layer
                for values, colour, opacity in pair
                if values is not None
                for layer in cloud(time, values * factor, colour, columns_for(width), opacity=opacity, trend=True)
            )
            drawn.append(Panel(signal_title(name, unit), curves, 110, levels=levels, ticks=3))
        return drawn

    alt = f"Recording {recording}: residual of {named(outputs)} before and after the model was extended."
    legend = tuple(entry for entry, found in ((("warm", "before"), before), (("accent", "after"), after)) if found)
    return Plate(
        draw(panels(WIDE), WIDE, alt, "time (s)"), draw(panels(NARROW), NARROW, alt, "time (s)"), alt,
        Markup("Measured minus model on one scale. Dashed: twice the noise floor."), legend,
    )  # fmt: skip


def port_plates(run: RunDirectory, recording: str) -> list[Plate]:
    """The signal inferred at each port that matters, against the states that explain it best, else against time."""
    plates = []
    ports, states = run.signals("port", recording), run.signals("portstate", recording)
    laws = run.signals("portlaw", recording)
    shown = _ports_that_matter(run, ports)
    for port, values in ports.items():
        if port not in shown:
            continue
        factor, unit = scaled_unit(largest(values), unit_of(run, port) or _PORT_UNITS.get(port, ""))
        axis = f"signal at port {port}" + (f" ({unit})" if unit else "")
        law = laws[port] * factor if port in laws else None
        ranked = sorted(states.items(), key=lambda item: -explained(item[1], values))
        for state, across in ranked[:STATES_SHOWN]:
            plates.append(_against_state(run, across, values * factor, law, axis, port, state))
        if not states:
            time = run.time(recording)
            curve = line(time, values * factor, ACCENT, columns_for(PORT))
            alt = f"Signal inferred at port {port} over time, recording {recording}."
            plates.append(Plate(draw([Panel(axis, (curve,), 190)], PORT, alt, "time (s)"), None, alt, Markup("")))
    return plates


def _ports_that_matter(run: RunDirectory, ports: Mapping[str, FloatArray]) -> set[str]:
    """Where an effect was added, else where the unknown signal explains most; all if the run does not say."""
    loop = mapping(run.result, "loop")
    added = {str(effect.get("port")) for effect in table(loop, "effects")} & set(ports)
    scores = {port: score for port, x in mapping(loop, "port_scores").items() if (score := number(x)) is not None}
    best = {max(scores, key=lambda port: scores[port])} & set(ports) if scores else set()
    return added or best or set(ports)


def explained(across: FloatArray, values: FloatArray, bins: int = 24) -> float:
    """Share of a signal's variance that its mean over bins of a state leaves no more."""
    both = np.isfinite(across) & np.isfinite(values)
    x, y = across[both], values[both]
    if x.size < 4 * bins or np.ptp(y) == 0.0:
        return 0.0
    parts = np.array_split(y[np.argsort(x, kind="stable")], bins)
    within = sum(float(np.sum((part - part.mean()) ** 2)) for part in parts)
    return 1.0 - within / float(np.sum((y - y.mean()) ** 2))


def replay_plate(run: RunDirectory) -> Plate | None:
    """The paper's Fig. 6: measured pitch and that of every model of Table 1."""
    found = {key.removeprefix("replay/"): run.series[key] for key in run.series if key.startswith("replay/")}
    time, measured = found.pop("time", None), found.pop("measured", None)
    models = {name: values for name, values in found.items() if time is not None and values.shape == time.shape}
    if time is None or len(time) < 2 or not (models or measured is not None):
        return None

    def panel(width: float) -> Panel:
        curves = [line(time, v, SERIES[i % len(SERIES)], columns_for(width)) for i, v in enumerate(models.values())]
        if measured is not None:
            curves.insert(0, line(time, measured, MEASURED, columns_for(width), 3.0))
        return Panel(
            "θ  pitch angle (rad)",
            tuple(curves),
            280 if width > 600 else 220,
            ticks=6,
            y_limits=_readable(found, measured),
        )

    alt = "Pitch angle over time, measured and as given by " + ", ".join(models) + "."
    legend = (("measured", "measured"), *((f"s{i % len(SERIES) + 1}", name) for i, name in enumerate(models)))
    return Plate(
        draw([panel(WIDE)], WIDE, alt, "time (s)"), draw([panel(NARROW)], NARROW, alt, "time (s)"), alt,
        Markup("The paper’s Fig. 6, redrawn from this run. A model that leaves the frame is cut off by it."), legend,
    )  # fmt: skip


def _readable(models: dict[str, FloatArray], measured: FloatArray | None) -> tuple[float, float] | None:
    """Limits about the measurement where a model leaves it by far, so that one wild curve does not flatten the rest."""
    if measured is None or not np.isfinite(measured).any():
        return None
    low, high = float(np.nanmin(measured)), float(np.nanmax(measured))
    reach = max((largest(values) for values in models.values()), default=0.0)
    span = high - low
    return (low - 1.2 * span, high + 1.2 * span) if reach > 4 * max(abs(low), abs(high)) > 0 else None


def _against_state(
    run: RunDirectory, across: FloatArray, values: FloatArray, law: FloatArray | None, axis: str, port: str, state: str
) -> Plate:
    factor, unit = scaled_unit(largest(across), unit_of(run, state) or _state_unit(state))
    both = np.isfinite(across) & np.isfinite(values)
    x, y = across[both] * factor, values[both]
    layers: list[Line | Band | Dots] = [Dots(*_occupied(x, y), MEASURED)]
    order = np.argsort(x, kind="stable")
    parts = np.array_split(order, max(4, min(40, len(order) // 25)))
    middle = np.array([np.median(x[part]) for part in parts])
    low, centre, high = np.transpose([np.quantile(y[part], (0.05, 0.5, 0.95)) for part in parts])
    layers += [Band(middle, low, high, ACCENT, 0.18), Line(middle, centre, ACCENT, 2.0)]
    if law is not None:
        grid = order[:: max(1, len(order) // 200)]
        layers.append(Line(x[grid], law[both][grid], INK, 1.4, dashes=True))
    label = plain_name(state) + (f" ({unit})" if unit else "")
    alt = f"Signal inferred at port {port} against {state}: points, median and 90 % range."
    words = "Points: inferred at each moment; line and band: median and 90 % range."
    words += " Dashed: what the added effect gives." if law is not None else ""
    return Plate(draw([Panel(axis, tuple(layers), 220)], PORT, alt, label), None, alt, Markup(words))


def _state_unit(state: str) -> str:
    tail = state.rsplit(".", 1)[-1]
    return {"omega": "rad/s", "omega_m": "rad/s", "w": "rad/s", "dtheta": "rad/s", "theta_dot": "rad/s",
            "theta": "rad", "phi": "rad", "i": "A", "i_m": "A", "V_m": "V"}.get(tail, "")  # fmt: skip


def _occupied(x: FloatArray, y: FloatArray, across: int = 110, up: int = 60) -> tuple[FloatArray, FloatArray]:
    """One point for each cell of a grid that holds any: thins a cloud and keeps its outliers."""
    cells = [np.minimum(((v - v.min()) / (np.ptp(v) or 1.0) * n).astype(int), n - 1) for v, n in ((x, across), (y, up))]
    _, first = np.unique(cells[0] * up + cells[1], return_index=True)
    return x[first], y[first]
