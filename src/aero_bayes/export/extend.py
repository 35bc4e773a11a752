"""Writes extended models: a base system with effects, learned curves or probe inputs put into its slots."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from aero_bayes.errors import InputError
from aero_bayes.export.catalogue import CATALOGUE, Effect, EffectParameter, Port
from aero_bayes.export.extension_text import THRUSTERS, Filling, model_text, real
from aero_bayes.export.library import check_model_name
from aero_bayes.files import whole_file

PROBES: Mapping[str, tuple[Port, str]] = {
    "u_electrical": ("electrical", "V"),
    "u_rotor": ("rotor", "N.m"),
    "u_thrust": ("thrust", "N"),
    "u_body": ("body", "N.m"),
}

_CURVES: dict[tuple[Port, str], tuple[str, str]] = {
    ("electrical", "i"): ("ElectricalCurve", ""),
    ("electrical", "w"): ("ElectricalSpeedCurve", ""),
    ("rotor", "w"): ("RotorCurve", ""),
    ("rotor", "i"): ("RotorCurrentCurve", ""),
    ("thrust", "w"): ("ThrustCurve", ""),
    ("thrust", "theta"): ("ThrustBodyCurve", "body.theta"),
    ("thrust", "theta_dot"): ("ThrustBodyCurve", "body.omega"),
    ("body", "theta"): ("BodyAngleCurve", ""),
    ("body", "theta_dot"): ("BodyRateCurve", ""),
}
_PORT_SLOT: dict[Port, tuple[str, str]] = {
    "electrical": ("ElectricalEffect", "V"),
    "rotor": ("RotorEffect", "N.m"),
    "thrust": ("ThrustEffect", "N"),
    "body": ("BodyEffect", "N.m"),
}

#: A propeller's loss over a state of the body is a share of its thrust: as a force it would be a torque on the body.
_SHARES: frozenset[tuple[Port, str]] = frozenset({("thrust", "theta"), ("thrust", "theta_dot")})

#: What a learned curve may be a function of, port by port: current, speed, pitch angle, pitch rate.
CURVE_STATES: Mapping[Port, tuple[str, ...]] = {
    port: tuple(over for p, over in _CURVES if p == port) for port in _PORT_SLOT
}


def curve_unit(port: Port, over: str) -> str:
    """Unit of a learned curve's values."""
    return "1" if (port, over) in _SHARES else _PORT_SLOT[port][1]


@dataclass(frozen=True)
class EffectUse:
    """An effect of the catalogue in a model: its id, values of its parameters, values of its smoothing constants."""

    id: str
    values: Mapping[str, float] = field(default_factory=dict)
    widths: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class FreeForm:
    """A learned curve at a port: ``values`` at equally spaced knots from ``x_min`` to ``x_max`` of the state ``over``.

    It is a loss: a voltage drop, a torque against the motion, a loss of thrust (over a state of the body: the share of
    the thrust that is lost). Beyond the outer knots it is straight.
    The values become top-level parameters ``<prefix>_1`` to ``<prefix>_n``.
    """

    port: Port
    over: str
    x_min: float
    x_max: float
    values: tuple[float, ...]
    prefix: str = "c"


@dataclass(frozen=True)
class ExtendedModel:
    """A written model: its name, its file, its text, the parameters and inputs that the base does not have."""

    name: str
    path: Path
    text: str
    parameters: tuple[EffectParameter, ...]
    inputs: tuple[str, ...] = ()


def write_extension(
    base: str,
    effects: Sequence[EffectUse | FreeForm],
    out_dir: Path | str,
    *,
    name: str | None = None,
    probes: bool = False,
) -> ExtendedModel:
    """Write ``base`` extended by effects and learned curves to ``out_dir/<name>.mo``.

    Parameters
    ----------
    base : str
        A system with slots, such as ``Aero.Systems.OneDof``.
    effects : sequence of EffectUse or FreeForm
        Several may share a port: voltages and thrusts act in series, torques in parallel.
    name : str, optional
        Name of the model; by default the base's with the effects'.
    probes : bool
        Also add the inputs of :data:`PROBES`, zero by default, at the ports.

    Returns
    -------
    ExtendedModel
        Export it with ``export_fmu(extended.name, out, sources=[extended.path])``.

    Raises
    ------
    InputError
        For an unknown base, effect, parameter or curve, or an effect given twice.
    """
    check_model_name(base)
    if base not in THRUSTERS:
        raise InputError(f"{base} has no slots for effects; expected one of {', '.join(THRUSTERS)}")
    fillings: list[Filling] = []
    parameters: list[EffectParameter] = []
    for use in effects:
        filling, new = _of_effect(use) if isinstance(use, EffectUse) else _of_curve(use)
        fillings.append(filling)
        parameters.extend(new)
    _refuse_duplicates([f.instance for f in fillings], "the effect")
    _refuse_duplicates([p.name for p in parameters], "the parameter")
    if probes:
        fillings += [_probe(u) for u in PROBES]
    chosen = name or _default_name(base, fillings)
    if "." in check_model_name(chosen):
        raise InputError(f"{chosen!r}: the name of an extended model has no dots")
    inputs = tuple(PROBES) if probes else ()
    text = model_text(base, chosen, fillings, parameters, PROBES if probes else {})
    path = Path(out_dir) / f"{chosen}.mo"
    _write(path, text)
    return ExtendedModel(chosen, path, text, tuple(parameters), inputs)


def write_probes(
    base: str, out_dir: Path | str, *, effects: Sequence[EffectUse | FreeForm] = (), name: str | None = None
) -> ExtendedModel:
    """Write ``base`` (with ``effects``, if any) with an input at every port, see :data:`PROBES`.

    The signals are positive where they pitch the body up: a voltage added at each motor, a torque added at each rotor,
    a force added to each thrust, a torque added at the pivot.
    """
    return write_extension(base, effects, out_dir, name=name or base.rpartition(".")[2] + "_probes", probes=True)


def write_screening(base: str, out_dir: Path | str, *, name: str | None = None) -> ExtendedModel:
    """Write ``base`` with every effect of the catalogue, each switched off."""
    uses = [EffectUse(id_) for id_ in CATALOGUE]
    return write_extension(base, uses, out_dir, name=name or base.rpartition(".")[2] + "_screening")


def _default_name(base: str, fillings: Sequence[Filling]) -> str:
    title = base.rpartition(".")[2]
    return f"{title}_{'_and_'.join(f.instance for f in fillings) or 'plain'}"


def _refuse_duplicates(names: Iterable[str], what: str) -> None:
    seen: set[str] = set()
    for n in names:
        if n in seen:
            raise InputError(f"{what} {n!r} is given twice")
        seen.add(n)


def _of_effect(use: EffectUse) -> tuple[Filling, list[EffectParameter]]:
    effect = CATALOGUE.get(use.id)
    if effect is None:
        raise InputError(f"unknown effect {use.id!r}; expected one of {', '.join(CATALOGUE)}")
    known = {p.name for p in effect.parameters}
    for given, allowed in ((use.values, known), (use.widths, set(effect.widths))):
        wrong = [n for n in given if n not in allowed]
        if wrong:
            raise InputError(f"effect {use.id} has no {wrong[0]!r}; expected {', '.join(sorted(allowed)) or 'nothing'}")
    modifiers = [(p.component_name or p.name, p.name) for p in effect.parameters]
    modifiers += [(n, real(v)) for n, v in use.widths.items()]
    filling = Filling(
        effect.slot, effect.id, f"Aero.Effects.{effect.model}", tuple(modifiers), effect.summary, effect.rank
    )
    return filling, [_with_default(p, use.values.get(p.name, p.default)) for p in effect.parameters]


def _with_default(p: EffectParameter, value: float) -> EffectParameter:
    return EffectParameter(
        p.name, p.unit, p.description, p.minimum, p.maximum, p.scale, p.starts, value, p.component_name
    )


def _of_curve(curve: FreeForm) -> tuple[Filling, list[EffectParameter]]:
    if (curve.port, curve.over) not in _CURVES:
        options = ", ".join(f"{p} over {o}" for p, o in _CURVES)
        raise InputError(f"no learned curve at {curve.port} over {curve.over}; expected {options}")
    if len(curve.values) < 2 or not curve.x_max > curve.x_min:
        raise InputError("a learned curve needs at least two values and x_min < x_max")
    model, bound = _CURVES[curve.port, curve.over]
    slot, unit = _PORT_SLOT[curve.port][0], curve_unit(curve.port, curve.over)
    names = [f"{curve.prefix}_{k + 1}" for k in range(len(curve.values))]
    modifiers = [("x", bound)] if bound else []
    modifiers += [("x_min", real(curve.x_min)), ("x_max", real(curve.x_max)), ("c", "{" + ", ".join(names) + "}")]
    scale = max(map(abs, curve.values)) or 1.0
    parameters = []
    for k, (n, value) in enumerate(zip(names, curve.values, strict=True)):
        at = curve.x_min + (curve.x_max - curve.x_min) * k / (len(names) - 1)
        text = f"Learned curve at {curve.over} = {at:.4g}"
        parameters.append(EffectParameter(n, unit, text, -1e3 * scale, 1e3 * scale, scale, (value,), value))
    summary = f"a learned curve over {curve.over} at the {curve.port} port"
    instance = f"free_form_{curve.port}_{curve.over}"
    return Filling(slot, instance, f"Aero.Effects.{model}", tuple(modifiers), summary, 10), parameters


def _probe(name: str) -> Filling:
    port, _ = PROBES[name]
    slot, _ = _PORT_SLOT[port]
    return Filling(slot, "probe", f"Aero.Effects.{port.capitalize()}Probe", (("u", name),), "an unknown signal", 20)


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def effect_of(id_: str) -> Effect:
    """The effect of that id. Raises InputError for an unknown one."""
    if id_ not in CATALOGUE:
        raise InputError(f"unknown effect {id_!r}; expected one of {', '.join(CATALOGUE)}")
    return CATALOGUE[id_]
