"""The Modelica text of an extended model, as a person would write it.

The modifiers stand at the component (``bodyEffect(tau_c = tau_c)``) and not in the redeclaration, where rumoca drops
them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from aero_bayes.export.catalogue import EffectParameter

THRUSTERS = {
    "Aero.Systems.OneDof": 2,
    "Aero.Systems.HalfQuad": 1,
    "Aero.Systems.OneDofLinear": 2,
    "Aero.Systems.HalfQuadLinear": 1,
}


@dataclass(frozen=True)
class _Slot:
    """A replaceable model of the base: its component, its partial model, what every filling is handed on."""

    component: str
    partial: str
    pass_on: tuple[str, ...]
    of_thruster: bool = False


_SLOTS: dict[str, _Slot] = {
    "ElectricalEffect": _Slot("electricalEffect", "ElectricalEffect", ("orientation", "w"), True),
    "RotorEffect": _Slot("rotorEffect", "RotorEffect", ("orientation", "i"), True),
    "ThrustEffect": _Slot("thrustEffect", "ThrustEffect", ("orientation", "w"), True),
    "BodyEffect": _Slot("bodyEffect", "BodyEffect", ("theta",)),
    "CurrentSensor": _Slot("currentSensor", "Sensor", ()),
    "SpeedSensor": _Slot("speedSensor", "Sensor", ()),
    "PitchSensor": _Slot("pitchSensor", "Sensor", ()),
}
_SERIES = {"ElectricalEffect": ("p", "n"), "ThrustEffect": ("propeller", "frame")}


@dataclass(frozen=True)
class Filling:
    """One component for a slot: instance name, class, modifiers at the system's level, what it is in words."""

    slot: str
    instance: str
    model: str
    modifiers: tuple[tuple[str, str], ...]
    summary: str
    rank: int


def model_text(
    base: str,
    name: str,
    fillings: Sequence[Filling],
    parameters: Sequence[EffectParameter],
    inputs: Mapping[str, tuple[str, str]],
) -> str:
    by_slot: dict[str, list[Filling]] = {}
    for f in sorted(fillings, key=lambda f: (f.rank, f.instance)):
        by_slot.setdefault(f.slot, []).append(f)
    redeclared: list[str] = []
    modified: dict[str, list[str]] = {}
    locals_: list[str] = []
    thrusters = [f"thruster_{k + 1}" for k in range(THRUSTERS[base])]
    for slot, here in by_slot.items():
        info = _SLOTS[slot]
        if len(here) == 1:
            redeclared.append(f"redeclare model {slot} = {here[0].model}")
            inner = _arguments(here[0].modifiers)
        else:
            redeclared.append(f"redeclare model {slot} = {slot}s")
            locals_.append(_composite(slot, info, here))
            inner = ", ".join(f"{f.instance}({_arguments(f.modifiers)})" for f in here)
        for owner in thrusters if info.of_thruster else [""]:
            modified.setdefault(owner, []).append(f"{info.component}({inner})")
    arguments = redeclared + modified.pop("", [])
    arguments += [f"{owner}({', '.join(items)})" for owner, items in modified.items()]
    title = base.rpartition(".")[2]
    what = " and ".join(dict.fromkeys(f.summary for f in fillings)) or "nothing added"
    short = what if len(what) <= 100 else "several effects"
    lines = ["within ;", f'model {name} "{title} with {short}"']
    if arguments:
        lines += [f"  extends {base}(", ",\n".join(f"    {a}" for a in arguments) + ");"]
    else:
        lines.append(f"  extends {base};")
    for p in parameters:
        lines.append(
            f'  parameter Real {p.name}(unit = "{p.unit}", min = {real(p.minimum)}, max = {real(p.maximum)}, '
            f'nominal = {real(p.scale)}) = {real(p.default)} "{p.description}";'
        )
    for u in inputs:
        lines.append(f'  input Real {u}(unit = "{inputs[u][1]}") "Unknown signal at the {inputs[u][0]} port";')
    lines += locals_
    lines += [
        "  annotation (",
        "    experiment(StartTime = 0, StopTime = 40, Tolerance = 1e-6),",
        f'    Documentation(info = "<html><p>{title} with {what}.</p></html>"));',
        f"end {name};",
        "",
    ]
    return "\n".join(lines)


def _arguments(modifiers: Iterable[tuple[str, str]]) -> str:
    return ", ".join(f"{n} = {v}" for n, v in modifiers)


def _composite(slot: str, info: _Slot, fillings: Sequence[Filling]) -> str:
    """A local model with several effects in one slot: in series where something passes through, else parallel."""
    lines = [f'  model {slot}s "Several effects in one place"', f"    extends Aero.Interfaces.{info.partial};"]
    handed = ", ".join(f"{n} = {n}" for n in info.pass_on)
    previous = "u"
    for f in fillings:
        if info.partial == "Sensor":
            handed = f"u = {previous}, du = du"
            previous = f"{f.instance}.y"
        lines.append(f"    {f.model} {f.instance}({handed});")
    lines.append("  equation")
    names = [f.instance for f in fillings]
    if info.partial == "Sensor":
        lines.append(f"    y = {previous};")
    elif slot in _SERIES:
        first, last = _SERIES[slot]
        ends = [first, *(f"{n}.{port}" for n in names for port in (first, last)), last]
        lines += [f"    connect({a}, {b});" for a, b in zip(ends[::2], ends[1::2], strict=True)]
        if slot == "ElectricalEffect":
            lines += [f"    connect(r, {n}.r);" for n in names]
    else:
        lines += [f"    connect(flange, {n}.flange);" for n in names]
    lines.append(f"  end {slot}s;")
    return "\n".join(lines)


def real(value: float) -> str:
    return repr(float(value))
