"""A model that is a Python function in place of an FMU, and its simulator."""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from aero_bayes.arrays import FloatArray
from aero_bayes.errors import InputError
from aero_bayes.simulation.interface import Outcome, Problem
from aero_bayes.simulation.model import Model
from aero_bayes.simulation.model_description import Variable
from aero_bayes.simulation.problem_checks import (
    SingleRuns,
    check_problem,
    parameters_of_run,
    signal_values,
    signals_of_run,
)

#: An input as a function of time (s), of a number or of an array.
Signal = Callable[[ArrayLike], FloatArray]
#: (parameters, inputs, times) -> each output at the times, shape (n,).
Function = Callable[[Mapping[str, float], Mapping[str, Signal], FloatArray], Mapping[str, ArrayLike]]


@dataclass(frozen=True, init=False, repr=False)
class FunctionModel(Model):
    """A model that is a Python function.

    It is fitted, sampled, predicted with and diagnosed as any model. It has no states and no equations that could be
    extended: the closed loop and the export of an FMU need Modelica or an FMU. Runs happen in the caller's process,
    one after the other.

    Parameters
    ----------
    function : callable
        ``function(parameters, inputs, times)`` gives a mapping with the values of each output at ``times`` (s), shape
        (n,). ``parameters`` is a mapping of names to numbers; ``inputs["u"](t)`` is the input's value at times of any
        shape. What it raises, and a value that is not finite, count as a failed run.
    parameters : mapping of str to float
        Names, and values where nothing else is said.
    outputs, inputs : sequence of str
    units : mapping of str to str, optional
        SI units of parameters, inputs and outputs.

    Examples
    --------
    >>> def decay(parameters, inputs, times):
    ...     return {"x": np.exp(-parameters["a"] * times)}
    >>> aero_bayes.FunctionModel(decay, parameters={"a": 1.0}, outputs=["x"])
    <Model decay: none -> x; 1 parameters, 0 states; Python>
    """

    function: Function | None = field(default=None, compare=False)

    def __init__(
        self,
        function: Function,
        *,
        parameters: Mapping[str, float],
        outputs: Sequence[str],
        inputs: Sequence[str] = (),
        units: Mapping[str, str] | None = None,
    ) -> None:
        known = units or {}

        def variables(names: Iterable[str], start: Mapping[str, float] | None = None) -> tuple[Variable, ...]:
            return tuple(
                Variable(name, known.get(name, ""), "", start[name] if start else None, None, None, None, k)
                for k, name in enumerate(names)
            )

        name = getattr(function, "__name__", type(function).__name__)
        # A function has no hash that would tell what it computes, so results of another session are not resumed.
        super().__init__(
            Path(name), uuid.uuid4().hex, name, "", name, variables(parameters, parameters), variables(inputs),
            variables(outputs), (), 0, has_directional_derivatives=False, needs_instance_per_process=False,
            interface="python",
        )  # fmt: skip
        object.__setattr__(self, "function", function)

    def __repr__(self) -> str:
        return super().__repr__().partition("; FMI")[0] + "; Python>"


class FunctionSimulator(SingleRuns):
    """Runs a problem whose model is a Python function."""

    def __init__(self, problem: Problem) -> None:
        check_problem(problem)
        self.problem = problem
        self._model = cast(FunctionModel, problem.model)
        self._defaults = {v.name: v.start or 0.0 for v in self._model.parameters}

    def run_once(self, number: int, values: FloatArray) -> tuple[FloatArray, Outcome]:
        """Simulate one experiment at one parameter vector (p,)."""
        experiment, row = self.problem.experiments[number], self.problem.targets[number]
        parameters = self._defaults | parameters_of_run(self.problem, number, values)
        inputs = {signal.name: partial(signal_values, signal) for signal in signals_of_run(experiment, row, values)}
        shape, failed = (experiment.time.size, len(experiment.outputs)), np.full(1, np.nan)
        assert self._model.function is not None
        try:
            with np.errstate(all="ignore"):
                answer = self._model.function(parameters, inputs, experiment.time)
        except Exception:
            return np.broadcast_to(failed, shape), Outcome.MODEL_ERROR
        columns = [np.asarray(_output(answer, name), dtype=float) for name in experiment.outputs]
        for name, column in zip(experiment.outputs, columns, strict=True):
            if column.shape != experiment.time.shape:
                raise InputError(
                    f"model {self._model.name}: {name} has shape {column.shape}, expected {experiment.time.shape}"
                )
        outputs = np.stack(columns, axis=1)
        if not np.isfinite(outputs).all():
            return np.broadcast_to(failed, shape), Outcome.NOT_FINITE
        return outputs, Outcome.OK


def _output(answer: Mapping[str, ArrayLike], name: str) -> ArrayLike:
    if name not in answer:
        raise InputError(f"the model's function gives no {name}; it gives {', '.join(answer)}")
    return answer[name]
