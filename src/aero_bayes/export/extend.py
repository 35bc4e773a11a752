"""Writes extended models: a base system with effects, learned curves or probe inputs put into its slots."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from aero_bayes.declared import Declaration, EffectParameter
from aero_bayes.errors import InputError
from aero_bayes.export.extension_text import Filling, model_text, real
from aero_bayes.export.library import check_model_name, declaration_of
from aero_bayes.files import whole_file


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

    port: str
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
    sources: Sequence[Path] = (),
) -> ExtendedModel:
    """Write ``base`` extended by effects and learned curves to ``out_dir/<name>.mo``.

    Parameters
    ----------
    base : str
        A system that its package declares, such as ``Aero.Systems.OneDof``.
    effects : sequence of EffectUse or FreeForm
        Several may share a port: voltages and thrusts act in series, torques in parallel.
    name : str, optional
        Name of the model; by default the base's with the effects'.
    probes : bool
        Also add an input ``u_<port>``, zero by default, at every port that has a probe.
    sources : sequence of Path
        Folders of packages, where it is not a shipped one.

    Returns
    -------
    ExtendedModel
        Export it with ``export_fmu(extended.name, out, sources=[*sources, extended.path])``.

    Raises
    ------
    InputError
        For an unknown base, effect, parameter or curve, or an effect given twice.
    """
    declared = declaration_of(check_model_name(base), sources)
    if base.partition(".")[2] not in declared.systems:
        raise InputError(f"{base} has no slots for effects; expected a system that its package declares")
    fillings: list[Filling] = []
    parameters: list[EffectParameter] = []
    for use in effects:
        filling, new = _of_effect(declared, use) if isinstance(use, EffectUse) else _of_curve(declared, use)
        fillings.append(filling)
        parameters.extend(new)
    _refuse_duplicates([f.instance for f in fillings], "the effect")
    _refuse_duplicates([p.name for p in parameters], "the parameter")
    probed = [port for port, it in declared.ports.items() if it.probe] if probes else []
    for port in probed:
        it, modifier = declared.ports[port], ("u", f"u_{port}")
        model = f"{declared.package}.{it.probe}"
        fillings.append(Filling(it.slot, "probe", model, (modifier,), "an unknown signal", 20))
    chosen = name or _default_name(base, fillings)
    if "." in check_model_name(chosen):
        raise InputError(f"{chosen!r}: the name of an extended model has no dots")
    text = model_text(base, chosen, declared, fillings, parameters, probed)
    path = Path(out_dir) / f"{chosen}.mo"
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return ExtendedModel(chosen, path, text, tuple(parameters), tuple(f"u_{port}" for port in probed))


def _default_name(base: str, fillings: Sequence[Filling]) -> str:
    title = base.rpartition(".")[2]
    return f"{title}_{'_and_'.join(f.instance for f in fillings) or 'plain'}"


def _refuse_duplicates(names: Iterable[str], what: str) -> None:
    seen: set[str] = set()
    for n in names:
        if n in seen:
            raise InputError(f"{what} {n!r} is given twice")
        seen.add(n)


def _of_effect(declared: Declaration, use: EffectUse) -> tuple[Filling, list[EffectParameter]]:
    effect = declared.effect(use.id)
    known = {p.name for p in effect.parameters}
    for given, allowed in ((use.values, known), (use.widths, set(effect.widths))):
        wrong = [n for n in given if n not in allowed]
        if wrong:
            raise InputError(f"effect {use.id} has no {wrong[0]!r}; expected {', '.join(sorted(allowed)) or 'nothing'}")
    modifiers = [(p.component_name or p.name, p.name) for p in effect.parameters]
    modifiers += [(n, real(v)) for n, v in use.widths.items()]
    slot, model = declared.slot_of(effect), f"{declared.package}.{effect.model}"
    filling = Filling(slot, effect.id, model, tuple(modifiers), effect.summary, effect.rank)
    return filling, [replace(p, default=use.values.get(p.name, p.default)) for p in effect.parameters]


def _of_curve(declared: Declaration, use: FreeForm) -> tuple[Filling, list[EffectParameter]]:
    curve, unit = declared.curve(use.port, use.over), declared.curve_unit(use.port, use.over)
    if len(use.values) < 2 or not use.x_max > use.x_min:
        raise InputError("a learned curve needs at least two values and x_min < x_max")
    names = [f"{use.prefix}_{k + 1}" for k in range(len(use.values))]
    modifiers = [("x", curve.x)] if curve.x else []
    modifiers += [("x_min", real(use.x_min)), ("x_max", real(use.x_max)), ("c", "{" + ", ".join(names) + "}")]
    scale = max(map(abs, use.values)) or 1.0
    parameters = []
    for k, (n, value) in enumerate(zip(names, use.values, strict=True)):
        at = use.x_min + (use.x_max - use.x_min) * k / (len(names) - 1)
        text = f"Learned curve at {use.over} = {at:.4g}"
        parameters.append(EffectParameter(n, unit, text, 1e3 * scale, scale, (value,), -1e3 * scale, default=value))
    summary = f"a learned curve over {use.over} at the {use.port} port"
    instance, model = f"free_form_{use.port}_{use.over}", f"{declared.package}.{curve.model}"
    return Filling(declared.ports[use.port].slot, instance, model, tuple(modifiers), summary, 10), parameters
