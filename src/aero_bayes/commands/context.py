"""The model's diagram, what else a page takes from the job, and the checkpoint that ``--resume`` continues from."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

from aero_bayes.checkpoint import Checkpoint, digest
from aero_bayes.commands.job import Job
from aero_bayes.errors import InputError
from aero_bayes.files import CHECKPOINT, one_run_at_a_time
from aero_bayes.modelica.class_reader import ComponentTree, build_tree, read_library
from aero_bayes.modelica.classes import ComponentDeclaration, annotation_arguments
from aero_bayes.modelica.library import modelica_root
from aero_bayes.modelica.parse import evaluate_expression
from aero_bayes.modelica.sources import modelica_files
from aero_bayes.modelica.syntax import Array, Call, Expression, arguments_of, short_text
from aero_bayes.report.results import versions
from aero_bayes.report.schema_run import ComponentJson, ConnectionJson, DiagramJson, ShapeJson

_SCALARS = {"Real", "Integer", "Boolean", "String"}

#: First and second part, points of the line, and whether only a value is handed on.
_Link = tuple[str, str, list[tuple[float, float]], bool]
_Terminal = Literal["", "input", "output", "connector"]


def model_diagrams(
    name: str, files: Iterable[Path], extended: str = "", ports: Sequence[str] = ()
) -> list[DiagramJson]:
    """Return the diagrams that show the place of an effect, as the model's authors drew them: that of the model, then
    one for each component within which the effect was added."""
    library = read_library(files)
    if name not in library:
        return []
    base = build_tree(library, name)
    shown = build_tree(library, extended) if extended in library else base
    return _of_tree(shown, base, name.rpartition(".")[2], ports) if any(shown.inside) else []


def _of_tree(shown: ComponentTree, base: ComponentTree, title: str, ports: Sequence[str]) -> list[DiagramJson]:
    changed = [part for part, tree in shown.inside.items() if not tree.same_as(base.inside.get(part))]
    visible = {name: part for name, part in shown.parts.items() if _is_visible(part, name in shown.inside)}
    placed = {name: place for name, part in visible.items() if (place := _placement(part)) is not None}
    marked = changed or [name for name in placed if {name, f"output_{name}"} & {*ports}]
    components = [
        ComponentJson(
            name=name, type=tree.name if (tree := shown.inside.get(name)) else visible[name].type,
            description=visible[name].description or (tree.description if tree else ""), extent=extent,
            rotation=turned, shapes=_shapes(tree.icon if tree else []), marked=name in marked,
            terminal=_terminal(visible[name]) or ("" if tree else "connector"),
        )
        for name, (extent, turned) in placed.items()
    ]  # fmt: skip
    links = _links(shown, {name: visible[name] for name in placed})
    connections = [ConnectionJson(first=a, second=b, points=points, signal=signal) for a, b, points, signal in links]
    found = [DiagramJson(title=title, components=components, connections=connections)] if {*marked} & {*placed} else []
    within: dict[str, ComponentTree] = {}
    for name in changed:
        before = base.inside.get(name)
        if before is not None and before.name == shown.inside[name].name and shown.inside[name].name not in within:
            within[shown.inside[name].name] = shown.inside[name]
            found += _of_tree(shown.inside[name], before, f"within {name}", ports)
    return found


def _is_visible(part: ComponentDeclaration, known: bool) -> bool:
    """Return components, inputs and outputs; not parameters, and not variables of the equations."""
    if part.prefixes & {"parameter", "constant"}:
        return False
    return known or bool(_terminal(part)) or (part.type not in _SCALARS and _placement(part) is not None)


def _terminal(part: ComponentDeclaration) -> _Terminal:
    return "input" if "input" in part.prefixes else "output" if "output" in part.prefixes else ""


def _placement(part: ComponentDeclaration) -> tuple[tuple[float, float, float, float], float] | None:
    where = annotation_arguments(part.annotation, "Placement").get("transformation")
    if where is None:
        return None
    given = arguments_of(where)
    corners = _points(given)
    if len(corners) != 2:
        return None
    (x1, y1), (x2, y2) = corners
    turned = _numbers(given.get("rotation"))
    return (x1, y1, x2, y2), turned[0] if turned else 0.0


def _links(shown: ComponentTree, visible: Mapping[str, ComponentDeclaration]) -> list[_Link]:
    """List connections, then equations and modifiers that hand a value over between parts not yet connected."""
    found: list[_Link] = []
    values = []
    for link in shown.links:
        ends = _head(link.first), _head(link.second)
        if not link.line and any(_terminal(visible[end]) for end in ends if end in visible):
            values.append(ends)
        else:
            found.append((*ends, _points(link.line, "points"), False))
    values += [(used, name) for name, part in visible.items() for used in _used(part)]
    found = [link for link in found if _joins(link, visible)]
    known = {frozenset(link[:2]) for link in found}
    for first, second in dict.fromkeys(values):
        if frozenset((first, second)) not in known and _joins((first, second), visible):
            found.append((first, second, [], True))
            known.add(frozenset((first, second)))
    return found


def _joins(link: Sequence[object], visible: Mapping[str, ComponentDeclaration]) -> bool:
    return link[0] != link[1] and {link[0], link[1]} <= visible.keys()


def _head(reference: str) -> str:
    return re.split(r"[.\[]", reference, maxsplit=1)[0]


def _used(part: ComponentDeclaration) -> list[str]:
    """Return names that its modifiers and its value use."""
    tokens = [*part.arguments, *part.binding]
    words = ["", *(t.word for t in tokens), ""]
    around = zip(words, tokens, words[2:], strict=False)
    return list(dict.fromkeys(t.word for dot, t, after in around if t.kind == "name" and after != "=" and dot != "."))


def _shapes(graphics: Sequence[Expression]) -> list[ShapeJson]:
    """Return icons without their colours, text and gradients."""
    found = []
    for item in graphics:
        kind = item.function.lower() if isinstance(item, Call) else ""
        given = arguments_of(item)
        points = _points(given, "points" if kind in {"line", "polygon"} else "extent")
        if kind not in {"line", "polygon", "rectangle", "ellipse"} or len(points) < 2:
            continue
        pattern = short_text(given["fillPattern"]) if "fillPattern" in given else ""
        filled = kind != "line" and not pattern.endswith("None") and bool(pattern)
        found.append(ShapeJson.model_validate({"kind": kind, "points": points, "filled": filled}))
    return found


def _points(given: Mapping[str, Expression], name: str = "extent") -> list[tuple[float, float]]:
    """Return pairs of numbers, moved by an origin."""
    pairs = given.get(name)
    x0, y0 = _numbers(given.get("origin")) or (0.0, 0.0)
    found = [_numbers(pair) for pair in (pairs.items if isinstance(pairs, Array) else ())]
    return [(pair[0] + x0, pair[1] + y0) for pair in found if len(pair) == 2]


def _numbers(tree: Expression | None) -> tuple[float, ...]:
    """Return the numbers of a list, or the one that a tree is; none where one of them is not given by itself."""
    if tree is None:
        return ()
    try:
        return tuple(evaluate_expression(item, {}) for item in (tree.items if isinstance(tree, Array) else (tree,)))
    except InputError:
        return ()


Json = dict[str, Any]


def context_part(job: Job, result: Mapping[str, Any]) -> Json:
    """Return ``diagrams``, ``signals``, ``words`` and ``settings`` of result.json.

    ``result`` is what was found so far: whether a loop extended the model, and the ids of effects that it names."""
    variables = (*job.model.inputs, *job.model.states, *job.model.outputs)
    return {
        "diagrams": [diagram.model_dump() for diagram in _diagrams(job, result.get("loop") or {})],
        "signals": {v.name: {"unit": v.unit, "description": v.description} for v in variables},
        "words": dict(result.get("words") or {}),
        "settings": job.config.model_dump(),
    }


def _diagrams(job: Job, loop: Mapping[str, Any]) -> list[DiagramJson]:
    effects = loop.get("effects", [])
    if not (job.modelica and effects):
        return []
    written = [job.options.out / effect["modelica"] for effect in effects if effect.get("modelica")]
    files = modelica_files([modelica_root(), *job.config.model.sources, *dict.fromkeys(written)])
    ports = [str(effect["id"]).partition("@")[2] or str(effect["port"]) for effect in effects]
    # what acts between two names is marked at both
    ports = [name for port in ports for name in port.split("-")]
    return model_diagrams(str(loop.get("base") or job.name), files, str(loop.get("model", "")), ports)


@contextmanager
def resumable(job: Job, command: str) -> Iterator[Checkpoint]:
    """Yield the checkpoint of a command: read with ``--resume``, removed once the command is done."""
    options = job.options
    path = options.out / CHECKPOINT
    data = [recording.to_dict() for recording in job.read]
    settings = job.config.model_dump(exclude={"posterior": True, "loop": {"max_minutes"}})
    identity = digest(command, versions(), options.seed, job.config.solver.engine, job.model.sha256, data, settings)
    with one_run_at_a_time(options.out):
        if not options.resume:
            path.unlink(missing_ok=True)
        yield Checkpoint(path, identity)
        path.unlink(missing_ok=True)
