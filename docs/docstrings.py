"""Docstrings in the numpydoc form, read: for the reference, and for the test that nothing public lacks one."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import aero_bayes

SECTIONS = ("Parameters", "Returns", "Raises", "Notes", "Examples")
#: Public beside ``aero_bayes.__all__``: what a model of one's own needs.
FURTHER = (
    "data.Layout", "data.write_csv", "estimate.CalibrationSettings", "estimate.parameters_from_model",
    "figures.Picture", "report.plots.palette",
)  # fmt: skip
#: Classes that a user only makes; their members serve fits.
ONLY_MADE = ("LogNormal", "LogUniform", "Normal", "Uniform")


@dataclass(frozen=True)
class Docstring:
    """The parts of a docstring: what stands before the first section, and each section's text."""

    text: str
    sections: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, thing: object) -> Docstring:
        """Read the docstring of anything that has one."""
        parts = re.split(rf"^({'|'.join(SECTIONS)})\n-+\n", inspect.getdoc(thing) or "", flags=re.M)
        named = zip(parts[1::2], parts[2::2], strict=True)
        return cls(parts[0].strip(), {name: body.strip("\n") for name, body in named})

    def entries(self, section: str) -> list[tuple[tuple[str, ...], str, str]]:
        """Return names, type and meaning of each entry of a section."""
        found = re.findall(r"^(\S.*)\n?((?:^[ \t]+.*\n?|^\n)*)", self.sections.get(section, ""), flags=re.M)
        entries = []
        for head, body in found:
            names, _, kind = head.partition(" : ")
            entries.append((tuple(name.strip(" *") for name in names.split(",")), kind, inspect.cleandoc(body)))
        return entries


@dataclass(frozen=True)
class Public:
    """A public function or class, or a member of one; ``owner`` is the class."""

    name: str
    thing: object
    owner: type | None = None

    @cached_property
    def doc(self) -> Docstring:
        """Its docstring."""
        return Docstring.of(self.thing)

    @property
    def plain(self) -> object:
        """What can be called or read, without the property or class method about it."""
        if isinstance(self.thing, property):
            return self.thing.fget
        return getattr(self.thing, "__func__", self.thing)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names that a caller may give."""
        if isinstance(self.thing, property):
            return ()
        if isinstance(self.thing, type) and issubclass(self.thing, Exception):
            return ()
        names = inspect.signature(self.thing).parameters  # type: ignore[arg-type]
        return tuple(name for name in names if name not in ("self", "cls"))


def public() -> Iterator[Public]:
    """Yield everything that ``import aero_bayes`` offers, members of classes after their class."""
    for path in (*aero_bayes.__all__, *FURTHER):
        room, _, name = path.rpartition(".")
        home = __import__(f"aero_bayes.{room}", fromlist=[name]) if room else aero_bayes
        thing = getattr(home, name)
        yield Public(path, thing)
        shown = isinstance(thing, type) and not room and name not in ONLY_MADE
        for member, value in _members(thing).items() if shown else ():
            if not member.startswith("_") and (callable(value) or isinstance(value, property | classmethod)):
                own = value if isinstance(value, property) else getattr(thing, member)
                yield Public(f"{path}.{member}", own, thing)


def _members(thing: type) -> dict[str, object]:
    """Collect what a class and the project's classes below it define; what a public class below it has is there."""
    offered = {getattr(aero_bayes, name) for name in aero_bayes.__all__} - {thing}
    elsewhere = {one for base in thing.__mro__ if base in offered for one in base.__mro__}
    bases = [b for b in reversed(thing.__mro__) if b.__module__.startswith("aero_bayes.") and b not in elsewhere]
    return {name: value for base in bases for name, value in vars(base).items()}
