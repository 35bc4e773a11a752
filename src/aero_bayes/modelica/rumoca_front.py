"""Modelica source -> flat model, by rumoca in a process of its own (it has been seen to crash).

What rumoca drops without a message is refused before, and arrays so large that it never ends."""

from __future__ import annotations

import codecs
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import scipy  # imports its parts when they are first used

from aero_bayes.display import join_names
from aero_bayes.errors import InputError
from aero_bayes.files import ScratchFolder, make_once
from aero_bayes.modelica.classes import CLASS_WORDS, dotted_name
from aero_bayes.modelica.edits import TextEdit, apply_edits
from aero_bayes.modelica.equation_system import translate
from aero_bayes.modelica.flat import FlatModel
from aero_bayes.modelica.graphs import reachable
from aero_bayes.modelica.library import (
    check_model_name,
    copy_sources,
    library_roots,
    link_packages,
    names_used_in,
    needed_libraries,
    rig_packages,
)
from aero_bayes.modelica.parse import Token, line_of, skip_group, split_outside, tokenize, words_of
from aero_bayes.modelica.rumoca_document import read_structured
from aero_bayes.modelica.sources import modelica_files, read_modelica_text, sources_in
from aero_bayes.modelica.syntax import names_in
from aero_bayes.modelica.units import to_modelica_unit
from aero_bayes.unknown_names import known_names_hint

#: Elements of an array at most.
LARGEST = 100_000


def _tokens(text: str) -> list[Token]:
    """Return the tokens of a source without its annotations."""
    found, at, tokens = [], 0, tokenize(text, strict=False)
    while at < len(tokens):
        if words_of(tokens[at : at + 2]) == ["annotation", "("]:
            at = skip_group(tokens, at + 1, strict=False)
        else:
            found.append(tokens[at])
            at += 1
    return found


def _modifiers(tokens: Sequence[Token]) -> Sequence[Token]:
    """Return the modifiers in parentheses after the name of a class."""
    at = dotted_name(tokens)[1]
    opened = words_of(tokens[at : at + 1]) == ["("]
    return tokens[at + 1 : skip_group(tokens, at, strict=False) - 1] if opened else ()


def _large(word: str) -> bool:
    return word.isdecimal() and int(word) > LARGEST


def _dropped(tokens: Sequence[Token]) -> Iterator[tuple[Token, str]]:
    """Tokens at which rumoca would drop something or not end, and the message for each."""
    for at, token in enumerate(tokens):
        rest = tokens[at + 1 :] if token.word in ("redeclare", "constrainedby", "extends") else ()
        modifiers = _modifiers(rest)
        name = dotted_name(rest)[0]
        if token.word == "redeclare":
            begin = next((k for k, t in enumerate(rest) if t.word not in ("final", "each", "replaceable")), 0)
            kind, own, equals = [*words_of(rest[begin : begin + 3]), "", "", ""][:3]
            if kind in CLASS_WORDS and equals == "=" and _modifiers(rest[begin + 3 :]):
                what = f"modifiers of the redeclared class {own!r} would be dropped"
                yield token, f"{what}; give them at the component that uses it"
        elif token.word == "constrainedby" and modifiers:
            what = f"modifiers of the constraining class {name!r} would be dropped"
            yield token, f"{what}; give them at the declaration"
        elif token.word in ("[", ":") and (size := words_of(tokens[at + 1 : at + 2])) and _large(size[0]):
            yield token, f"an array or a loop of {size[0]} elements; at most {LARGEST} can be exported"
        elif "break" in words_of(modifiers):
            yield token, f"'break' in the modification of {name!r} would be ignored"


def refuse_dropped(root: Path, sources: Iterable[Path]) -> None:
    """Raise InputError, with file and line, where one of the sources has a construct that rumoca would drop."""
    for path in sources:
        text = path.read_text(encoding="utf-8", errors="replace")
        for token, message in _dropped(_tokens(text)):
            raise InputError(f"{path.relative_to(root)}:{line_of(text, token.start)}: {message}")


def _likely(model: str, root: Path) -> list[Path]:
    """Return the user's own files, then the one that is named like the model."""
    files = sorted(root.rglob("*.mo"))
    shipped = {folder.name for folder in rig_packages()}
    own = [p for p in files if p.relative_to(root).parts[0] not in shipped]
    return [*own, *(p for p in files if p.stem == model.rpartition(".")[2])]


def _sections(text: str) -> Iterator[tuple[Token, str]]:
    """Yield the algorithm sections that are in no function, each with its text."""
    tokens = _tokens(text)
    inside = False
    for at, token in enumerate(tokens):
        before, after = words_of(tokens[max(at - 1, 0) : at]), words_of(tokens[at + 1 : at + 2])
        short = words_of(tokens[at + 2 : at + 3]) == ["="]
        if token.word in CLASS_WORDS and before != ["end"] and not short:
            inside = token.word == "function"
        elif token.word == "end" and inside and after and after[0] not in ("if", "for", "while", "when"):
            inside = False
        elif token.word == "algorithm" and not inside:
            yield token, text[token.start :]


def _derivatives(text: str) -> Iterator[tuple[Token, str]]:
    """Yield where ``der`` stands, with what is in its parentheses."""
    tokens = _tokens(text)
    for at, token in enumerate(tokens):
        if token.word == "der" and words_of(tokens[at + 1 : at + 2]) == ["("]:
            end = skip_group(tokens, at + 1, strict=False) - 1
            yield token, text[tokens[at + 1].end : tokens[end].start].strip()


def _unread(message: str, text: str) -> Iterator[tuple[Token, str]]:
    """Where a source may have the construct that rumoca does not read, and what to write instead of it."""
    if "initial algorithm" in message:
        for token, _ in _sections(text):
            if text[: token.start].rstrip().endswith("initial"):
                yield token, "an initial algorithm is not read; write its starts as an initial equation"
    elif "expandable connector" in message:
        for token in _tokens(text):
            if token.word == "expandable":
                yield token, "a connection adds no member to an expandable connector; declare its members in it"
    elif "model algorithm" in message:
        quoted = re.search(r"read of `([^`]+)`", message)
        what = "an algorithm section that assigns a variable twice, or has a loop, is not read"
        for token, body in _sections(text):
            if quoted is None or re.search(rf"\b{re.escape(quoted[1])}\s*:=", body):
                yield token, f"{what}; put it into a function and call that"
    elif "der(...)" in message:
        span = re.search(r"BytePos\((\d+)\)", message)
        begin = len(text.encode()[: int(span[1])].decode(errors="replace")) if span is not None else None
        for token, of in _derivatives(text):
            if token.start == begin:
                yield token, f"the derivative of {of!r} is not known, since it is no state; make it an input of its own"
            elif begin is None and not re.fullmatch(r"[\w.\[\], ]+", of):
                what = f"the derivative of an expression is not read; declare a variable z = {of}, and write der(z)"
                yield token, what


def explain(message: str, model: str, root: Path) -> str:
    """Return what to write instead of a construct that rumoca does not read, with ``file:line``, else the message."""
    for path in _likely(model, root):
        text = path.read_text(encoding="utf-8", errors="replace")
        for token, what in _unread(message, text):
            return f"{path.relative_to(root)}:{line_of(text, token.start)}: {what}"
    return message


def locate(message: str, model: str, root: Path) -> str:
    """Return the message with ``file:line`` before it: of a name that it quotes, else of the class."""
    message = explain(message, model, root)
    if re.match(r"[^ :]+\.mo:\d+: ", message):
        return message
    for quoted in re.findall(r"['`]([^'`]+)['`]", message):
        wanted = words_of(tokenize(quoted, strict=False))
        for path in _likely(model, root):
            text = path.read_text(encoding="utf-8", errors="replace")
            tokens = _tokens(text)
            words = ["", *words_of(tokens), ""]
            for at, token in enumerate(tokens):
                whole = "." not in (words[at], words[at + 1 + len(wanted)] if at + len(wanted) < len(words) - 1 else "")
                if wanted and words[at + 1 : at + 1 + len(wanted)] == wanted and whole:
                    return f"{path.relative_to(root)}:{line_of(text, token.start)}: {message}"
    name = model.rpartition(".")[2]
    for path in _likely(model, root):  # no name, or none that stands there: the class itself
        text = path.read_text(encoding="utf-8", errors="replace")
        for token, following in pairwise(_tokens(text)):
            if token.word in CLASS_WORDS and following.word == name:
                return f"{path.relative_to(root)}:{line_of(text, token.start)}: {message}"
    return message


#: Begins the names of what is added to a model so that rumoca, which refuses an imbalance, flattens it.
ADDED = "added_unknown_"
#: Names that a message lists at most.
MAX_LISTED = 6


def balanced_model(model: str, missing: int) -> str:
    """Return a model with as many further equations, or further unknowns, as it takes for equally many of both."""
    lines = ["  time = 0;"] * missing if missing > 0 else [f"  Real {ADDED}{k};" for k in range(-missing)]
    return "\n".join(
        ["model Balanced", f"  extends {model};", *(["equation"] if missing > 0 else []), *lines, "end Balanced;\n"]
    )


def explain_imbalance(name: str, flat: FlatModel) -> InputError | None:
    """Return the error of a model that was flattened with :func:`balanced_model`.

    None where its structure does not tell."""
    system = translate(flat)
    b = system.builder
    unknowns = [b.symbol(v.name) for v in system.variables if v.name not in system.derivatives]
    unknowns = [u for u in unknowns if not u.name.startswith(ADDED)] + list(system.derivatives.values())
    index = {u: k for k, u in enumerate(unknowns)}
    rows = [found for r in system.residuals if (found := [index[s] for s in b.symbols(r) if s in index])]
    columns: list[list[int]] = [[] for _ in unknowns]
    for k, row in enumerate(rows):
        for u in row:
            columns[u].append(k)
    ends = np.cumsum([0, *map(len, rows)])
    entries = (np.ones(ends[-1]), [u for row in rows for u in row], ends)
    graph = scipy.sparse.csr_array(entries, shape=(len(rows), len(unknowns)))
    unknown_of = scipy.sparse.csgraph.maximum_bipartite_matching(graph, perm_type="column").tolist()
    equation_of = {u: k for k, u in enumerate(unknown_of) if u >= 0}
    # all that could be left over in place of what is, by exchanges along the matching
    few = reachable(set(range(len(unknowns))) - {*equation_of}, lambda u: (unknown_of[k] for k in columns[u]))
    spare = (k for k, u in enumerate(unknown_of) if u < 0)
    many = [unknown_of[k] for k in reachable(spare, lambda k: (equation_of[u] for u in rows[k]))]
    count = f"{name}: {len(rows)} equations for {len(unknowns)} unknowns: "
    if few:
        listed = [unknowns[u].name for u in sorted(few)]
        places = [v.place for v in flat.variables if v.place is not None and v.name in _plain(listed)]
        return InputError(f"{places[0] if places else name}: {count}too few equations determine {_some(listed)}")
    listed = [unknowns[u].name for u in sorted(set(many)) if u >= 0]
    told = [
        e.place
        for e in flat.equations
        if e.place and _plain(listed) & {n for t in (e.left, e.right) for n in names_in(t)}
    ]
    return InputError(f"{told[-1]}: {count}too many equations determine {_some(listed)}") if told else None


def _plain(names: Iterable[str]) -> set[str]:
    """Return variables by the names of their elements and derivatives."""
    return {re.sub(r"^der\(|\)$|\[[\d,]*\]", "", name) for name in names}


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:MAX_LISTED]) + (f" and {len(names) - MAX_LISTED} more" if len(names) > MAX_LISTED else "")


#: Seconds; what takes longer is seldom finished in minutes, and the memory goes first.
RUMOCA_TIME_LIMIT = 50.0
_TOO_LONG = "an expression of very many operands is too long; name parts of it, or write sum() of an array"
_CHILD_PROGRAM = """
import json, os, re, sys
import rumoca
roots, file, model, *own = sys.argv[1:]
roots = roots.split(os.pathsep)
try:
    loaded = rumoca.Session(roots=roots).load(file, model=model)
    flat = loaded.to_json("flat")
    used = set(map(int, re.findall(r'"source": ?(\\d+)', flat)))
    files = {}
    for key, path, text in json.loads(loaded.to_json("dae"))["source_map"]["files"]:
        if key in used:
            files[key] = [os.path.relpath(path, roots[0]) if path.startswith(roots[0] + os.sep) else path, text]
    print('{"flat": ' + flat + ', "files": ' + json.dumps(files) + "}")
except BaseException as error:  # a panic is no Exception
    answer = {"error": str(error), "where": ""}
    for name in own:
        with open(name, encoding="utf-8") as stream:
            for found in rumoca.validate_source(stream.read(), filename=name):
                answer["where"] = answer["where"] or str(found.message)
    print(json.dumps(answer))
"""


def load_flat(model: str, sources: Sequence[Path] = (), libraries: Sequence[Path] = ()) -> FlatModel:
    """Flatten a Modelica model."""
    check_model_name(model)
    with ScratchFolder() as root:
        files = copy_sources(root, sources)
        packages = needed_libraries(model, files, library_roots(libraries))
        own = files[len(rig_packages()) :]
        folders = {f: f.parent for f in own if f.name == "package.mo" and f.parent != root}
        added = [p for f in own for p in (folders[f].rglob("*.mo") if f in folders else [f])]
        refuse_dropped(root, added)
        _normalise_units(added)
        words = {*model.split("."), *names_used_in(added)}
        staged = [f.parent.name for f in files if f.name == "package.mo" and f.parent.name in words]
        _name_packages([*packages, *staged], _file_of(model, files))
        links = [link_packages(packages, words)] if packages else []
        try:
            answer = _run(model, root, files, links)
            return read_structured(model, answer["flat"], answer["files"])
        except RecursionError:
            raise InputError(f"{_longest(added, root)}: {model}: {_TOO_LONG}") from None
        except InputError as error:
            unequal = re.search(r"unbalanced model: (\d+) equations, (\d+) unknowns", str(error))
            told = _imbalance(model, root, files, links, unequal) if unequal else None
            told = told or _no_such_class(model, root, added, packages, sources)
            raise told or InputError(_with_semicolon(locate(str(error), model, root), added)) from None


def _with_semicolon(message: str, files: Sequence[Path]) -> str:
    """Say where a semicolon may be missing: at the end of the line before an unexpected word."""
    place = re.match(r"(.+):(\d+): unexpected", message)
    file = next((f for f in files if place and f.as_posix().endswith(f"/{place[1]}")), None)
    if place is None or file is None:
        return message
    lines = file.read_text("utf-8").splitlines()[: int(place[2]) - 1]
    last = next((k for k in reversed(range(len(lines))) if lines[k].split("//")[0].strip()), None)
    text = "" if last is None else lines[last].split("//")[0].strip()
    open_end = re.search(r"([;({=+*/^,-]|\b(equation|algorithm|public|protected|then|else|loop|and|or|not))$", text)
    if last is None or open_end or text.startswith(("model ", "class ", "block ", "package ", "within ")):
        return message
    return f"{message}; is there a ; missing at the end of line {last + 1}?"


def _imbalance(
    model: str, root: Path, files: Sequence[Path], links: Sequence[Path], unequal: re.Match[str]
) -> InputError | None:
    """Return which variables or equations are left over; None where that cannot be told."""
    file = root / "Balanced.mo"
    file.write_text(balanced_model(model, int(unequal[2]) - int(unequal[1])), "utf-8")
    with suppress(InputError, RecursionError):
        answer = _run("Balanced", root, [*files, file], links)
        return explain_imbalance(model, read_structured(model, answer["flat"], answer["files"]))
    return None


def _longest(files: Sequence[Path], root: Path) -> str:
    """File and line of the longest statement."""
    found = [(len(s), f, line_of(text, s[0].start)) for f in files if (text := f.read_text("utf-8"))
             for s in split_outside(tokenize(text, strict=False), ";") if s]  # fmt: skip
    _, file, line = max(found)
    return f"{file.relative_to(root)}:{line}"


def _no_such_class(
    model: str, root: Path, own: Sequence[Path], libraries: Collection[str], sources: Sequence[Path]
) -> InputError | None:
    """Return what to say where the class is in none of the sources.

    None where it may be, or where they cannot be read."""
    first = model.split(".")[0]
    shipped = [root / folder.name for folder in rig_packages() if folder.name == first]
    try:
        known = sources_in([*own, *modelica_files(shipped)]).by_name
    except InputError:
        return None
    if model in known or first in libraries:
        return None
    if not known:
        what = f"{model}: no such class; name its file by"
        return InputError(f"{what} sources=", f"{what} [model] sources or --source")
    place = join_names(list(dict.fromkeys(Path(s).name for s in sources))) or first
    return InputError(f"{model}: no such class in {place}{known_names_hint(model, known)}")


def _run(model: str, root: Path, files: Sequence[Path], libraries: Sequence[Path]) -> dict[str, Any]:
    """Return the answer of rumoca on a model; read from the user's cache where it answered the same question before.

    Answers that depend on libraries outside ``root`` are not kept, since nobody looks whether these change."""

    def ask() -> bytes:
        return json.dumps(_ask(model, root, files, libraries)).encode()

    if libraries:
        return _ask(model, root, files, libraries)
    names = sorted(path for path in root.rglob("*") if path.is_file())
    question = f"{version('rumoca')}{_CHILD_PROGRAM}{model}{[str(f.relative_to(root)) for f in files]}"
    texts = [part for path in names for part in (str(path.relative_to(root)).encode(), path.read_bytes())]
    answer: dict[str, Any] = json.loads(make_once(f"{model}.json", (question.encode(), *texts), ask))
    return answer


def _ask(model: str, root: Path, files: Sequence[Path], libraries: Sequence[Path]) -> dict[str, Any]:
    """Run rumoca in a process of its own."""
    roots = os.pathsep.join(map(str, (root, *libraries)))
    own = [str(f.relative_to(root)) for f in files[len(rig_packages()) :]]
    # what MODELICAPATH names is linked where it is needed; rumoca would read all of it
    environment = {k: v for k, v in os.environ.items() if k != "MODELICAPATH"}
    command = [sys.executable, "-c", _CHILD_PROGRAM, roots, str(_file_of(model, files)), model, *own]
    try:
        done = subprocess.run(
            command, cwd=root, env=environment, capture_output=True, text=True, check=False, timeout=RUMOCA_TIME_LIMIT
        )
    except subprocess.TimeoutExpired:
        what = f"rumoca did not finish within {RUMOCA_TIME_LIMIT:g} s; are there arrays or loops of very many elements?"
        raise InputError(f"{model}: {what}") from None
    if done.returncode == -signal.SIGSEGV:
        raise RecursionError  # its stack is full
    try:
        answer: dict[str, Any] = json.loads(done.stdout)
    except ValueError:
        raise InputError(f"{model}: rumoca crashed on this model (status {done.returncode})") from None
    if "error" in answer:
        line = _one_line(str(answer["error"]), model, root)
        raise InputError(_with_place(line, str(answer["where"]), model))
    return answer


def _normalise_units(files: Iterable[Path]) -> None:
    """Write units as the grammar has them: rumoca refuses ``kg*m^2``, and byte-order marks, which other tools take."""
    for file in files:
        text = read_modelica_text(file)
        tokens = tokenize(text, strict=False)
        given = (t for key, equals, t in zip(tokens, tokens[1:], tokens[2:], strict=False)
                 if key.word in ("unit", "displayUnit") and equals.word == "=" and t.kind == "text")  # fmt: skip
        edits = [
            TextEdit(t.start + 1, t.end - 1, s) for t in given if (s := to_modelica_unit(t.word[1:-1])) != t.word[1:-1]
        ]
        if edits or file.read_bytes().startswith(codecs.BOM_UTF8):
            file.write_bytes(apply_edits(text, edits).encode())


def _name_packages(packages: Collection[str], main: Path) -> None:
    """Name libraries at the end of the file that is loaded: rumoca opens only those that it finds named in that one."""
    if packages:
        with main.open("a", encoding="utf-8") as file:
            file.write(f"\n// {' '.join(f'{name}.' for name in packages)}\n")


def _with_place(line: str, diagnostic: str, model: str) -> str:
    """Put file and line before a message where rumoca tells them, else the model."""
    diagnostic = re.sub(r"\n *\u2502 (?=\S)", " ", diagnostic)  # a message that was wrapped
    syntax = re.search(r"\u00d7 (.+?)\n.*?\[([^\]:]+:\d+)(?::\d+)?\]", diagnostic, re.DOTALL)
    if syntax is not None and (syntax[1] in line or "parse failed" in line):
        return f"{syntax[2]}: {syntax[1]}"
    placed = re.fullmatch(r"(.*) \[([^\]:]+\.mo:\d+)(?::\d+)?\]", line)
    if placed is not None:
        return f"{placed[2]}: {placed[1]}"
    return line if re.match(r"[^ :]+\.mo:\d+: ", line) else f"{model}: {line}"


def _file_of(model: str, files: Sequence[Path]) -> Path:
    first = model.split(".")[0]
    for file in files:
        name = file.parent.name if file.name == "package.mo" else file.stem
        if name == first:
            return file
    return files[-1]


def _one_line(text: str, model: str, root: Path) -> str:
    lines = [line.strip(" -") for line in text.replace(str(root) + "/", "").splitlines() if line.strip()]
    line = lines[0] if lines else "rumoca failed without a message"
    unsupported = re.search(r"unsupported-feature:(?:dae-modelica-scalar:)?(\w+)", line)
    if unsupported:
        return f"the embedded exporter does not support {unsupported[1].replace('_', ' ')}"
    located = next((other for other in lines[1:] if ".mo [" in other), "")
    file = located.split(" [")[0] if located else ""
    message = re.sub(r"^\w+ failed: ", "", line)
    message = re.sub(rf"^{re.escape(model)} (failed in \w+: |could not be compiled: ?)", "", message)
    return f"{file}: {message}" if file and file not in message else message
