"""The XML of a model description, which may come from anywhere."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from aero_bayes.errors import InputError


class _DoctypeError(Exception):
    """The document declares a document type."""


class _Builder(ElementTree.TreeBuilder):
    """Builds elements and stops at a document type, in whatever encoding it is written."""

    def doctype(self, *_: object) -> None:
        raise _DoctypeError


def parse_description(path: Path, text: bytes) -> Element:
    """Return the root of a model description; InputError for what is no XML or declares entities."""
    parser = ElementTree.XMLParser(target=_Builder())
    try:
        parser.feed(text)
        root: Element = parser.close()
        return root
    except _DoctypeError:
        raise InputError(f"{path}: modelDescription.xml declares a document type, which no FMU needs") from None
    except ElementTree.ParseError as error:
        raise InputError(f"{path}: modelDescription.xml is not valid XML: {error}") from error


def is_true(element: Element, key: str) -> bool:
    """Return a Boolean attribute, false where it is missing."""
    return element.get(key, "false") in ("true", "1")


def checked_identifier(path: Path, interface: Element) -> str:
    """Return the name of the binary."""
    identifier = interface.get("modelIdentifier", "")
    if not identifier or "/" in identifier or "\\" in identifier:
        raise InputError(f"{path}: the model identifier {identifier!r} is not a file name")
    return identifier


def step_size(root: Element, interface: Element) -> float | None:
    """Return the communication step in s that an FMU names: its internal one, or that of its default experiment."""
    experiment = root.find("DefaultExperiment")
    named = interface.get("fixedInternalStepSize") or (experiment.get("stepSize") if experiment is not None else None)
    return float(named) if named and float(named) > 0.0 else None
