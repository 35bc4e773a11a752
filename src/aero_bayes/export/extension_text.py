"""The Modelica text of an extended model, as a person would write it.

The modifiers stand at the component (``bodyEffect(tau_c = tau_c)``) and not in the redeclaration, where rumoca drops
them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from aero_bayes.declared import Declaration, EffectParameter, Slot


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
    declared: Declaration,
    fillings: Sequence[Filling],
    parameters: Sequence[EffectParameter],
    probed: Sequence[str],
) -> str:
    """The text; ``probed`` are ports that get an input ``u_<port>``."""
    by_slot: dict[str, list[Filling]] = {}
    for f in sorted(fillings, key=lambda f: (f.rank, f.instance)):
        by_slot.setdefault(f.slot, []).append(f)
    redeclared: list[str] = []
    modified: dict[str, list[str]] = {}
    locals_: list[str] = []
    places = declared.systems[base.partition(".")[2]]
    for slot, here in by_slot.items():
        info = declared.slots[slot]
        if len(here) == 1:
            redeclared.append(f"redeclare model {slot} = {here[0].model}")
            inner = _arguments(here[0].modifiers)
        else:
            redeclared.append(f"redeclare model {slot} = {slot}s")
            locals_.append(_composite(declared.package, slot, info, here))
            inner = ", ".join(f"{f.instance}({_arguments(f.modifiers)})" for f in here)
        for owner in places[info.within] if info.within else [""]:
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
    for port in probed:
        unit = declared.ports[port].unit
        lines.append(f'  input Real u_{port}(unit = "{unit}") "Unknown signal at the {port} port";')
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


def _composite(package: str, slot: str, info: Slot, fillings: Sequence[Filling]) -> str:
    """A local model with several effects in one slot: in series where something passes through, else parallel."""
    lines = [f'  model {slot}s "Several effects in one place"', f"    extends {package}.{info.partial};"]
    handed = [(n, n) for n in info.hands]
    previous = info.signal[0] if info.signal else ""
    for f in fillings:
        passed = [(info.signal[0], previous)] if info.signal else []
        lines.append(f"    {f.model} {f.instance}({_arguments([*passed, *handed])});")
        previous = f"{f.instance}.{info.signal[1]}" if info.signal else ""
    lines.append("  equation")
    names = [f.instance for f in fillings]
    if info.signal:
        lines.append(f"    {info.signal[1]} = {previous};")
    if info.series:
        first, last = info.series
        ends = [first, *(f"{n}.{end}" for n in names for end in (first, last)), last]
        lines += [f"    connect({a}, {b});" for a, b in zip(ends[::2], ends[1::2], strict=True)]
    lines += [f"    connect({c}, {n}.{c});" for c in info.shared for n in names]
    lines.append(f"  end {slot}s;")
    return "\n".join(lines)


def real(value: float) -> str:
    return repr(float(value))
