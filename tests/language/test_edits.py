"""Reading and editing Modelica source: random sources whose structure is known, and sources a person would write."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
from numpy.random import Generator
from small_rigs import RIGS

from aero_bayes.errors import InputError
from aero_bayes.laws.find import is_driver
from aero_bayes.laws.insertion_point import find_insertion_point
from aero_bayes.modelica.class_reader import read_classes
from aero_bayes.modelica.classes import ClassText
from aero_bayes.modelica.edits import (
    TextEdit,
    add_declarations,
    add_equations,
    apply_edits,
    insert_before_connector,
    rename_class,
    replace_names,
    unified_diff,
)
from aero_bayes.modelica.parse import one_line, sides_of, tokenize

pytestmark = pytest.mark.fast

NOISE = [
    " ",
    "\n",
    "  ",
    " // equation x = y; end Fake;\n",
    " /* model A; equation connect(a, b);\n end A; */ ",
    "\n  // annotation (\n",
    "\t",
]
TEXTS = ['"equation a = b; end M;"', '"it says \\"end\\" (here"', '"annotation(x = {1, 2});"', '"//"', '"/*"']


@dataclass
class Known:
    """What a written class holds, in order."""

    name: str
    declared: list[str] = field(default_factory=list)
    equations: list[str] = field(default_factory=list)
    inside: list[tuple[str, ...]] = field(default_factory=list)
    classes: list[Known] = field(default_factory=list)


class Author:
    """Writes random Modelica with every trap for a reader."""

    def __init__(self, rng: Generator) -> None:
        self.rng = rng
        self.count = 0

    def pick(self, options: list[str]) -> str:
        return options[int(self.rng.integers(len(options)))]

    def gap(self) -> str:
        return " " + "".join(self.pick(NOISE) for _ in range(int(self.rng.integers(3))))

    def new(self, stem: str) -> str:
        self.count += 1
        return f"{stem}_{self.count}"

    def note(self) -> str:
        text = self.gap() + self.pick(TEXTS) if self.rng.random() < 0.4 else ""
        if self.rng.random() < 0.3:
            text += (
                self.gap() + f"annotation{self.gap()}(Line(points = {{{{0, 1}}, {{2, 3}}}}), info = {self.pick(TEXTS)})"
            )
        return text

    def expression(self) -> str:
        return self.pick(["a * b - c", "if a > b then c else -c", "f({1, 2}, x[end])", "(a + b) / c", "sin(w * time)"])

    def equation(self, known: Known, inside: tuple[str, ...] = ()) -> str:
        kind = self.rng.random()
        if kind < 0.15 and len(inside) < 2:
            inner = "".join(self.equation(known, (*inside, "if")) for _ in range(2))
            other = self.equation(known, (*inside, "if"))
            head = self.pick(["a > b", "if a then b else c", "(if p then q else r)"])
            return f"if{self.gap()}{head}{self.gap()}then{self.gap()}{inner}else{self.gap()}{other}end if;{self.gap()}"
        if kind < 0.25 and len(inside) < 2:
            return f"for i in 1:3 loop{self.gap()}{self.equation(known, (*inside, 'for'))}end for;{self.gap()}"
        text = f"der({self.new('x')}){self.gap()}={self.gap()}{self.expression()}"
        if kind > 0.85:
            text = f"connect({self.new('p')}.a, {self.new('q')}.b)"
        known.equations.append(text)
        known.inside.append(inside)
        return f"{text}{self.note()};{self.gap()}"

    def write(self, depth: int = 0) -> tuple[str, Known]:
        known = Known(self.new("M"))
        body = ""
        for _ in range(int(self.rng.integers(1, 5))):
            if depth < 2 and self.rng.random() < 0.3:
                text, inner = self.write(depth + 1)
                known.classes.append(inner)
                body += text + self.gap()
                continue
            name = self.new("v")
            known.declared.append(name)
            prefix = self.pick(["", "parameter ", "input ", "protected ", "public "])
            value = self.pick(["", " = 2 * a", " = if b then 1 else 2", '(start = 1, unit = "N.m")', "[3] = {1, 2, 3}"])
            body += f"{prefix}{self.gap()}Real {name}{value}{self.note()};{self.gap()}"
        if self.rng.random() < 0.9:
            body += "equation" + self.gap() + "".join(self.equation(known) for _ in range(int(self.rng.integers(1, 6))))
        if self.rng.random() < 0.5:
            body += f"annotation (Documentation(info = {self.pick(TEXTS)}));{self.gap()}"
        head = f"{self.pick(['model', 'partial model', 'block'])} {known.name}{self.gap()}"
        return f"{head}{self.pick([*TEXTS, ''])}{self.gap()}{body}end {known.name};", known


def same(cls: ClassText, known: Known, text: str) -> None:
    assert cls.name == known.name
    assert [c.name for c in cls.components()] == known.declared
    assert [s.inside for s in cls.equations] == known.inside
    for s, equation in zip(cls.equations, known.equations, strict=True):
        assert text[s.core[0].start : s.core[-1].end] == equation
    assert len(cls.classes) == len(known.classes)
    for inner, expected in zip(cls.classes, known.classes, strict=True):
        same(inner, expected, text)


@pytest.mark.parametrize("seed", range(40))
def test_random_sources_are_read_as_written_and_edited_in_place(seed):
    author = Author(np.random.default_rng(seed))
    text, known = author.write()
    (cls,) = read_classes(text)
    same(cls, known, text)
    edits = [*rename_class(cls, "Copy"), *add_declarations(text, cls, ["Real new_one;"])]
    edits += add_equations(text, cls, ["new_one = 1;"])
    touched = {}
    moved: list[TextEdit] = []
    for k, s in enumerate(cls.equations):
        name = known.equations[k].partition("(")[2].partition(")")[0]
        sides = sides_of(s.core)
        entry = (
            find_insertion_point(sides, is_driver(f"der({name})"), constants=frozenset("c"), values={})
            if sides
            else None
        )
        if entry is not None:
            edits += entry.insert("term")
            touched[k] = name
        elif s.first == "connect":
            moved += insert_before_connector(text, [s], known.equations[k][8:-1].split(", ")[1], [("e.p", "e.n")])
    after = apply_edits(text, [*edits, *moved])
    (changed,) = read_classes(after)
    assert changed.name == "Copy"
    assert [c.name for c in changed.components() if c.name != "new_one"] == known.declared
    assert sum("new_one" in [t.word for t in s.tokens] for s in changed.equations) == 1
    terms = [s for s in changed.equations if any(t.word == "term" for t in s.tokens)]
    assert len(terms) == len(touched)
    assert all(any(t.word == name for t in s.tokens) for s, name in zip(terms, touched.values(), strict=True))
    connections = [k for k in known.equations if k.startswith("connect")]
    split = sum(s.first == "connect" and not s.inside for s in cls.equations)
    assert sum(s.first == "connect" for s in changed.equations) == len(connections) + split
    # nothing that was there is gone: the old text is what is left when the insertions are taken out
    kept = iter(apply_edits(text, edits).replace("Copy", cls.name))
    assert all(c in kept for c in text.replace(" ", "").replace("\n", ""))
    diff = unified_diff(text + "\n", after + "\n", "a", "b")
    assert diff.startswith("--- a\n+++ b\n")


def test_every_shipped_class_is_read():
    """Every file of the packages and the test rigs: names match, equations end where they should."""
    files = [*RIGS.glob("*.mo"), *(RIGS.parents[1] / "modelica").rglob("*.mo")]
    assert len(files) > 80
    for path in files:
        text = path.read_text(encoding="utf-8")
        for top in read_classes(text):
            for cls in top.walk():
                assert cls.end_name is not None
                assert cls.end_name.word == cls.name
                for s in cls.equations:
                    assert text[s.end - 1] == ";"
                    assert s.first == "connect" or sides_of(s.core) is not None


@pytest.mark.parametrize(
    ("equation", "expected"),
    [
        ("M*der(v) = u - F*v", "M*der(v) = u - F*v - f"),
        ("M*der(v) + F*v = u", "M*der(v) + F*v + f = u"),
        ("0 = u - F*v - M*der(v)", "0 = u - F*v - M*der(v) - f"),
        ("der(v) = (u - F*v)/M", "der(v) = (u - F*v - f)/M"),
        ("der(v) = 1/M*(u - F*v)", "der(v) = 1/M*(u - F*v - f)"),
        ("der(v) = -(F*v - u)/M", "der(v) = -(F*v - u + f)/M"),
        ("der(v) = if u > 1 then 2 else 3", "der(v) = (if u > 1 then 2 else 3) - f"),
        ("u = M*der(v)", "u - f = M*der(v)"),
        ("-M*der(v) = F*v - u", "-M*der(v) = F*v - u + f"),
        ("der(v) = -g/M*sin(x)", "der(v) = -g/M*sin(x) - f"),
        ("(u - F*v) = M*der(v)", "(u - F*v - f) = M*der(v)"),
        ("n*der(v) = u", "n*der(v) = u + f"),
        ("M*(der(v) + g) = u", "M*(der(v) + g) = u - f"),
        ("v = 2*x", None),
        ("der(v)^2 = u", None),
        ("der(v) = der(v) - u", None),
    ],
)
def test_an_opposing_term_reads_as_a_person_would_write_it(equation, expected):
    """``n`` is negative, ``M`` and ``g`` are constants."""
    sides = sides_of(tokenize(equation))
    assert sides is not None
    entry = find_insertion_point(sides, is_driver("der(v)"), constants=frozenset({"M", "g"}), values={"n": -1.0})
    assert (None if entry is None else apply_edits(equation, entry.insert("f"))) == expected


def test_names_are_replaced_but_not_modifiers_or_members():
    text = "connect(u.p, s.u); y = u + f(u = u, g(u = 2 * u)) + a[u]; Part p(u = u, k = u)"
    edits = replace_names(tokenize(text), {"u": "law.y"}.get)
    assert apply_edits(text, edits) == (
        "connect(law.y.p, s.u); y = law.y + f(u = law.y, g(u = 2 * law.y)) + a[law.y]; Part p(u = law.y, k = law.y)"
    )


def test_comments_stay_with_what_they_speak_of():
    text = "model A\n  Real x; // position\n  Real v;\nequation\n  der(x) = v; // kinematics\n  /* on */\nend A;\n"
    (cls,) = read_classes(text)
    after = apply_edits(text, [*add_declarations(text, cls, ["Real w;"]), *add_equations(text, cls, ["w = x;"])])
    assert after == (
        "model A\n  Real x; // position\n  Real v;\n  Real w;\nequation\n  der(x) = v; // kinematics\n  w = x;\n"
        "  /* on */\nend A;\n"
    )


def test_a_class_without_equations_gets_a_section():
    for tail in ("end A;\n", "  annotation (Icon());\nend A;\n"):
        text = "model A\n  Real x = 1;\n" + tail
        (cls,) = read_classes(text)
        after = apply_edits(text, add_equations(text, cls, ["y = x;"]))
        assert after == "model A\n  Real x = 1;\nequation\n  y = x;\n" + tail


def test_what_is_no_modelica_is_named_with_its_line():
    with pytest.raises(InputError, match="line 3"):
        read_classes("model A\n  Real x;\n  $\nend A;")
    with pytest.raises(InputError, match="semicolon"):
        read_classes("model A\n  Real x\nend A")
    with pytest.raises(InputError, match="end of 'A' is missing"):
        read_classes("model A\n  Real x;\n")


def test_overlapping_edits_are_refused():
    with pytest.raises(ValueError, match="overlap"):
        apply_edits("abcdef", [TextEdit(0, 3, "x"), TextEdit(2, 4, "y")])


def test_one_line_keeps_strings_and_drops_comments():
    text = 'f = k * v // drag\n    * v /* and\n more */ "two  blanks // here";'
    assert one_line(text) == 'f = k * v * v "two  blanks // here";'
