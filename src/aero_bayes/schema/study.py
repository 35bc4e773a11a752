"""A section that a study outside this package adds to the page of its run."""

from __future__ import annotations

from aero_bayes.schema.base import JsonNumber, JsonTable


class StudyColumnJson(JsonTable):
    """A column of a study's table: its heading, and how many significant digits its numbers are shown with."""

    title: str
    digits: int = 3


class StudyRowJson(JsonTable):
    """A row of a study's table: what it is, a note below that, and one number a column."""

    label: str
    note: str = ""
    values: list[JsonNumber] = []


class StudyJson(JsonTable):
    """A section of the page: curves of one output over time, a table, and sentences.

    The curves are the keys ``NAME/time``, ``NAME/measured`` and ``NAME/LABEL`` of ``series.npz``, where ``NAME`` is
    ``name``. The row whose number in column ``smallest_in`` is the smallest is emphasised."""

    name: str
    title: str
    output: str = ""
    figure_caption: str = ""
    table_caption: str = ""
    columns: list[StudyColumnJson] = []
    rows: list[StudyRowJson] = []
    smallest_in: int | None = None
    notes: list[str] = []
