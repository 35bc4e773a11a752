"""Calls an FMU's functions by variable name, for the tests of the export."""

from __future__ import annotations

import ctypes
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Model
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class Driven:
    """One Model-Exchange instance."""

    def __init__(self, path: Path, unpacked: str) -> None:
        self.description = read_model_description(str(path))
        self.folder = unpacked
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}
        self.parameters = [v.name for v in self.description.modelVariables if v.causality == "parameter"]
        self.starts = {v.name: float(v.start) for v in self.description.modelVariables if v.start is not None}
        derivatives = [u.variable for u in self.description.derivatives]
        self.states = [d.derivative.name for d in derivatives]
        self.rates = [d.name for d in derivatives]
        self.fmu = FMU2Model(
            guid=self.description.guid,
            unzipDirectory=self.folder,
            modelIdentifier=self.description.modelExchange.modelIdentifier,
            instanceName="test",
        )
        self.fmu.instantiate()

    def set(self, **values: float) -> None:
        self.set_all(values)

    def set_all(self, values: dict[str, float]) -> None:
        self.fmu.setReal([self.references[n] for n in values], list(values.values()))

    def get(self, *names: str) -> FloatArray:
        return np.array(self.fmu.getReal([self.references[n] for n in names]))

    def begin(self, time: float = 0.0) -> None:
        self.fmu.setupExperiment(startTime=time)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        self.fmu.newDiscreteStates()
        self.fmu.enterContinuousTimeMode()

    def move(self, x: FloatArray, time: float = 0.0) -> None:
        self.fmu.setTime(time)
        buffer = (ctypes.c_double * len(x))(*x)
        self.fmu.setContinuousStates(buffer, len(x))

    def rhs(self, x: FloatArray, time: float = 0.0) -> FloatArray:
        self.move(x, time)
        buffer = (ctypes.c_double * len(x))()
        self.fmu.getDerivatives(buffer, len(x))
        return np.array(buffer)

    def position(self) -> FloatArray:
        buffer = (ctypes.c_double * len(self.states))()
        self.fmu.getContinuousStates(buffer, len(self.states))
        return np.array(buffer)

    def slope(self, unknown: list[str], known: str) -> FloatArray:
        return np.array(
            self.fmu.getDirectionalDerivative([self.references[n] for n in unknown], [self.references[known]], [1.0])
        )


@contextmanager
def driven(path: Path) -> Iterator[Driven]:
    with tempfile.TemporaryDirectory() as folder:
        instance = Driven(path, str(extract(str(path), folder)))
        try:
            yield instance
        finally:
            instance.fmu.freeInstance()
