"""What the closed loop found, as plain typed values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field

from aero_bayes.arrays import FloatArray
from aero_bayes.data.split import ROLES, Recordings, Role
from aero_bayes.display import table_html
from aero_bayes.errors import InputError
from aero_bayes.estimate.calibrated_model import CalibratedModel
from aero_bayes.estimate.diagnosis import Diagnosis, DiagnosisRow
from aero_bayes.estimate.identifiability import Estimate, Identifiability
from aero_bayes.estimate.noise import OutputNoise
from aero_bayes.estimate.predict_recordings import Prediction, Shift, shifts
from aero_bayes.estimate.residual_tests import RecordingError, ResidualReport, reports_by_recording
from aero_bayes.estimate.result import Fit
from aero_bayes.figures import HasPage, Picture, drawn, page_of
from aero_bayes.files import ScratchFolder
from aero_bayes.loop.decide import Decision
from aero_bayes.loop.extend import ExtendedFit, FoundEffect, Limit
from aero_bayes.loop.first_fit import FirstFit
from aero_bayes.loop.table import Structure, Table
from aero_bayes.plain import ByName, JsonNumber, JsonTable, Number, picked
from aero_bayes.unknown_names import known_names_hint

if TYPE_CHECKING:
    import pandas


def free_estimates(fit: Fit) -> dict[str, Estimate]:
    """Return the estimates of the free parameters of a fit."""
    names = (fit.calibration.parameters.items[j].name for j in fit.free)
    return {name: fit.parameters[name] for name in names}


@dataclass(frozen=True)
class StepCandidate:
    """A term beside those of the rounds before: the left-out error with it, refitted or not, over that without it."""

    id: str
    port: str
    share: Number
    share_sd: Number
    refitted: bool = True


@dataclass(frozen=True)
class Step:
    """What one term is worth beside those before it; ``equivalent`` are those that do as well in its place."""

    round: int
    candidates: tuple[StepCandidate, ...] = ()
    chosen: str | None = None
    equivalent: tuple[str, ...] = ()
    why: str = ""


def steps_of(table: Table, decision: Decision, required: Structure) -> tuple[Step, ...]:
    """Return one step for each term of the model, the one that explains most first, and one for what is left."""
    found: list[Step] = []
    base, left = tuple(sorted(required)), [t for t in decision.model if t not in required]
    while base in table.rows:
        larger = (k for k in table.rows if len(k) == len(base) + 1 and set(base) < set(k))
        beside = {next(iter(set(k) - set(base))): k for k in larger}
        chosen = min((t for t in left if t in beside), key=lambda t: table.order(beside[t]), default=None)
        chosen = chosen or next(iter(left), None)
        rivals = [
            StepCandidate(t, table.ports.get(t, ""), *table.share(k, base)[:2], table.rows[k].refitted)
            for t, k in beside.items()
        ]
        rivals.sort(key=lambda one: (one.share, one.id))
        if chosen is None:
            if not rivals:
                break
            why = f"with {rivals[0].id} the error on left-out readings {fall(rivals[0].share, rivals[0].share_sd)}"
            return (*found, Step(len(found) + 1, tuple(rivals), None, (), f"no further term is in the model; {why}"))
        claim = decision.claims[chosen]
        alike = tuple(o for o, _ in claim.alternatives)
        why = f"with {chosen} the error of {claim.share_of} on left-out readings {fall(claim.share, claim.share_sd)}"
        why += f"; the data do not tell it from {', '.join(alike)}" if alike else ""
        found.append(Step(len(found) + 1, tuple(rivals), chosen, (chosen, *alike) if alike else (), why))
        left.remove(chosen)
        base = tuple(sorted((*base, chosen)))
    return tuple(found)


def fall(share: float, sd: float) -> str:
    """How far an error falls, in words."""
    verb, change = ("rises", share - 1.0) if share > 1.0 else ("falls", 1.0 - share)
    return f"{verb} by {100.0 * change:.0f} % (+- {100.0 * sd:.0f})"


#: Height of the page in a notebook, in pixels: one screen.
FRAME_HEIGHT = 700
LoopOutcome = Literal["adequate", "extended", "unexplained"]


RmsByRole = dict[str, dict[str, JsonNumber]]


class PartJson(JsonTable):
    """Readings of a recording in one role, from ``begin`` (s) on and before ``end``."""

    recording: str
    role: Role
    begin: JsonNumber = None
    end: JsonNumber = None


class LoopJson(JsonTable):
    """The closed loop; ``before``, ``after`` and their like are by role (train, validation, test) and output.

    ``blocks`` of readings give standard errors; ``refused`` are models that explain training readings better and
    predict validation readings worse."""

    outcome: LoopOutcome
    sentence: str = ""
    base: str = ""
    model: str = ""
    effects: list[FoundEffect] = Field(default_factory=list)
    equivalent: list[list[str]] = Field(default_factory=list)
    limits: list[Limit] = Field(default_factory=list)
    parts: list[PartJson] = Field(default_factory=list)
    errors: list[RecordingError] = Field(default_factory=list)
    diagnosis_before: list[DiagnosisRow] = Field(default_factory=list)
    refused: list[list[str]] = Field(default_factory=list)
    before: RmsByRole = Field(default_factory=dict)
    after: RmsByRole = Field(default_factory=dict)
    before_sd: RmsByRole = Field(default_factory=dict)
    after_sd: RmsByRole = Field(default_factory=dict)
    noise_floor: dict[str, JsonNumber] = Field(default_factory=dict)
    steps: list[Step] = Field(default_factory=list)
    shifts: ByName[Shift] = Field(default_factory=dict)
    whiteness: dict[str, dict[str, dict[str, ResidualReport]]] = Field(default_factory=dict)
    blocks: int = 0
    story: list[str] = Field(default_factory=list)
    diff: str = ""
    modelica_source: str = ""
    notes: list[str] = Field(default_factory=list)
    simulations: int = 0
    failures: int = 0
    seconds: dict[str, float] = Field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class LoopResult(HasPage):
    """The outcome of a closed loop.

    Parameters
    ----------
    outcome : {"adequate", "extended", "unexplained"}
    sentence : str
        Why, in words.
    base : str
        Class of the model as it stood.
    first : FirstFit
        The model as it stood, fitted: its calibration, what it leaves, and the noise floors.
    predicted_before : Prediction
        What this predicts of all recordings, and its errors by role: training, validation, test.
    table : Table
        All structures with their errors, on which the decision was made.
    decision : Decision
        The terms of the model that came out, with what is claimed of each.
    final : ExtendedFit
        The model that came out, fitted: its effects and new parameters, what it leaves and predicts.
    limits : tuple of Limit
        The smallest size of each law at each port that these recordings would have shown.
    steps : tuple of Step
        One for each term that was chosen, and one for what was tried beside them.
    errors : tuple of RecordingError
        Of both models on each recording, with what was fitted of it apart from what was not.
    story : tuple of str
        What was done, in sentences.
    words : mapping of str to str
        What candidates are, by id.
    data_notes : tuple of str
    recordings : Recordings
        What was fitted and predicted.
    calibrated : CalibratedModel, optional
        The model that came out with all its values, as Modelica; none where the model came as an FMU.
    simulations, failures : int
    seconds : mapping of str to float
    scratch : ScratchFolder, optional
        Holds the FMUs that ``before`` and ``after`` simulate, as long as the result lives.

    Examples
    --------
    >>> loop.outcome, loop.effects[0].id, loop.effects[0].claim
    ('extended', 'coulomb_friction@v', 'law')
    >>> bool(loop.predicted_after.pooled("test")["position"] < loop.predicted_before.pooled("test")["position"])
    True
    >>> friction = loop.effects[0].parameters[0]
    >>> friction.unit, bool(friction.q05 < friction.value < friction.q95)  # the truth is 0.4 N
    ('N', True)
    >>> [row.cause for row in loop.diagnosis if row.found]
    ['model']
    >>> loop.calibrated.name, loop.to_dict()["outcome"], loop.diff[:3]
    ('Rig_coulomb_friction_fitted', 'extended', '---')
    >>> loop.model, loop.modelica_path, "F_c * tanh(v" in loop.modelica
    ('Rig_coulomb_friction', 'Rig_coulomb_friction.mo', True)
    >>> loop.before.rms["position"] > 2 * loop.noise["position"].sd > loop.after.rms["position"]
    True
    >>> loop.equivalent, loop.refused, [shift.name for shift in loop.shifts]  # nothing else does as well
    ((), (), ['k', 'd'])
    >>> str(loop.identifiability.status["F_c"])
    'identified'
    >>> loop.series()["before/test/position"].shape == (test.rows,)
    True
    """

    outcome: LoopOutcome
    sentence: str
    base: str
    first: FirstFit
    predicted_before: Prediction
    table: Table
    decision: Decision
    final: ExtendedFit
    limits: tuple[Limit, ...]
    steps: tuple[Step, ...]
    errors: tuple[RecordingError, ...]
    story: tuple[str, ...]
    words: Mapping[str, str]
    data_notes: tuple[str, ...]
    recordings: Recordings
    calibrated: CalibratedModel | None
    simulations: int
    failures: int
    seconds: Mapping[str, float]
    scratch: ScratchFolder | None = field(default=None, repr=False)

    @property
    def fit(self) -> Fit:
        """The fit of the model that came out: what takes a fit takes the loop's result, too.

        Examples
        --------
        >>> loop.fit["k"].unit
        'N/m'
        """
        return self.final.fit

    @property
    def before(self) -> Fit:
        """The fit of the model as it stood."""
        return self.first.fit

    @property
    def after(self) -> Fit:
        """The fit of the model that came out; that of the model as it stood where nothing was added."""
        return self.final.fit

    @property
    def predicted_after(self) -> Prediction:
        """What the model that came out predicts of all recordings, and its errors by role."""
        return self.final.after

    @property
    def model(self) -> str:
        """Class of the model that came out."""
        return self.final.written.name if self.final.written is not None else self.base

    @property
    def modelica(self) -> str:
        """The source of the extended model; empty where nothing was written."""
        return self.final.written.text if self.final.written is not None else ""

    @property
    def modelica_path(self) -> str:
        """The name of its file."""
        return self.final.written.path.name if self.final.written is not None else ""

    @property
    def diff(self) -> str:
        """What it changes in the model as it stood."""
        return self.final.written.diff if self.final.written is not None else ""

    @property
    def effects(self) -> tuple[FoundEffect, ...]:
        """What was added, and what is claimed of each."""
        return self.final.effects

    @property
    def equivalent(self) -> tuple[Structure, ...]:
        """Each effect with what does as well in its place."""
        claims = self.decision.claims.items()
        return tuple((t, *(o for o, _ in c.alternatives)) for t, c in claims if c.alternatives)

    @property
    def refused(self) -> tuple[Structure, ...]:
        """Models, by their terms, that explain training recordings better and predict validation readings worse."""
        return self.decision.refused

    @property
    def shifts(self) -> tuple[Shift, ...]:
        """How far parameters moved when the effects came in."""
        return shifts(self.before, self.after) if self.effects else ()

    @property
    def identifiability(self) -> Identifiability:
        """What the data say of each parameter of the model that came out."""
        return self.after.identifiability

    @property
    def noise(self) -> Mapping[str, OutputNoise]:
        """Noise of each output beside the model that came out."""
        return self.after.noise

    @property
    def diagnosis(self) -> Diagnosis:
        """Of the model as it stood: no effect is looked for in what another cause explains."""
        return self.before.diagnosis

    @property
    def parameters(self) -> dict[str, Estimate]:
        """Parameters of the model that came out that were fitted, with their intervals."""
        return free_estimates(self.after)

    def summary(self) -> str:
        """Return the parameters of the model that came out as a table: value, 90 % interval, unit, status.

        Examples
        --------
        >>> loop.summary().splitlines()[1].split()[:2]
        ['parameter', 'value']
        """
        return self.after.summary()

    def to_matlab(self, path: Path | str) -> Path:
        """Write the values of the model that came out for MATLAB to a ``path``; see :meth:`Fit.to_matlab`.

        Examples
        --------
        >>> loop.to_matlab("loop.m").name
        'loop.m'
        """
        return self.after.to_matlab(path)

    def __getitem__(self, name: str) -> Estimate:
        if name not in self.parameters:
            raise InputError(f"no parameter {name!r}{known_names_hint(str(name), self.parameters)}")
        return self.parameters[name]

    def export_fmu(self, path: Path | str) -> Path:
        """Write the FMU of the model that came out, with all its values.

        Parameters
        ----------
        path : path
            The FMU; it appears whole or not at all.

        Raises
        ------
        InputError
            For a model that was given as an FMU.

        Examples
        --------
        >>> loop.export_fmu("Rig_with_friction.fmu").name
        'Rig_with_friction.fmu'
        """
        if self.calibrated is None:
            raise InputError(
                f"{self.base}: was given as an FMU; {self.model}.mo has it with its values, for other tools"
            )
        return self.calibrated.export_fmu(path)

    def plot(self, *, dark: bool = False) -> Picture:
        """Draw what the models before and after make of data that was not fitted, and what each leaves.

        Of the output that most was left of. Dashed: twice the noise floor.

        Parameters
        ----------
        dark : bool
            Colours for a dark background.

        Returns
        -------
        Picture

        Examples
        --------
        >>> loop.plot().save("loop.svg").name
        'loop.svg'
        """
        return drawn("scene_picture", self, dark=dark)

    def plot_rounds(self, *, dark: bool = False) -> Picture:
        """Draw by how much each candidate lowers the error on left-out readings, step by step; orange: chosen.

        Parameters
        ----------
        dark : bool
            Colours for a dark background.

        Returns
        -------
        Picture

        Raises
        ------
        InputError
            If nothing was tried, since the residual was noise.

        Examples
        --------
        >>> loop.plot_rounds().save("rounds.svg").name
        'rounds.svg'
        """
        return drawn("rounds_picture", self, dark=dark)

    def to_frame(self) -> pandas.DataFrame:
        """Return a row for each candidate of each round.

        Port, share of the left-out error, whether it was chosen.

        Examples
        --------
        >>> loop.to_frame().query("chosen")["candidate"].to_list()
        ['coulomb_friction@v']
        """
        import pandas

        rows = [(s.round, r.id, r.port, r.share, r.id == s.chosen) for s in self.steps for r in s.candidates]
        return pandas.DataFrame(rows, columns=["round", "candidate", "port", "share", "chosen"])

    def __repr__(self) -> str:
        found = ", ".join(effect.id for effect in self.effects)
        return f"<LoopResult {self.base}: {self.outcome}{f' by {found}' if found else ''}; {self._errors()}>"

    def _repr_html_(self) -> str:
        """Return the errors as a table, and the page below it; where a viewer shows no frames, the table alone."""
        rows = [
            (role, output, f"{rms:.4g}", f"{self.predicted_after.pooled(role)[output]:.4g}")
            for role in ROLES
            for output, rms in self.predicted_before.pooled(role).items()
        ]
        table = table_html(("data", "output", "error before (RMS)", "error after (RMS)"), rows, self.sentence)
        page = escape(page_of(self), quote=True)
        return f'{table}<iframe title="report" srcdoc="{page}" width="100%" height="{FRAME_HEIGHT}"></iframe>'

    def _errors(self) -> str:
        """RMS by output on data that was not fitted, before and after."""
        role = self.predicted_before.judged
        before, after = (p.pooled(role) for p in (self.predicted_before, self.predicted_after))
        words = (f"{output} {rms:.3g} -> {after[output]:.3g}" for output, rms in before.items())
        return f"RMS on {role} data: {', '.join(words)}"

    def to_dict(self) -> dict[str, object]:
        """Return the ``loop`` entry of result.json."""
        roles, before, after = ROLES, self.predicted_before, self.predicted_after
        return picked(
            LoopJson, self, diagnosis_before=self.diagnosis.rows,
            before={role: before.pooled(role) for role in roles}, after={role: after.pooled(role) for role in roles},
            before_sd={role: before.uncertainty(role) for role in roles},
            after_sd={role: after.uncertainty(role) for role in roles},
            noise_floor=_pooled_floors(self.first.floors), blocks=self.table.blocks,
            shifts={shift.name: shift for shift in self.shifts},
            whiteness={
                "before": reports_by_recording(self.first.reports),
                "after": reports_by_recording(self.final.reports),
            },
            modelica_source=self.modelica, notes=self.data_notes,
            parts=[
                {"recording": p.recording.name, "role": p.role, "begin": p.begin, "end": p.end}
                for p in self.recordings.parts
            ],
        )  # fmt: skip

    def series(self) -> dict[str, FloatArray]:
        """Arrays for the page, by the names that it expects (see :mod:`aero_bayes.report`).

        On each recording's own samples.
        """
        arrays: dict[str, FloatArray] = {}
        for (recording, output), fitted in self.predicted_before.fitted.items():
            arrays[f"before/{recording}/{output}"] = fitted
        for (recording, output), fitted in self.predicted_after.fitted.items():
            arrays[f"after/{recording}/{output}"] = fitted
        return arrays


def _pooled_floors(floors: Mapping[tuple[str, str], float]) -> dict[str, float]:
    by: dict[str, list[float]] = {}
    for (_, output), value in floors.items():
        by.setdefault(output, []).append(value)
    return {output: float(np.sqrt(np.mean(np.square(values)))) for output, values in by.items()}
