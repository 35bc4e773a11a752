"""FMUs as FMPy loads them, FMI 3.0 under the names of FMI 2.0."""

from __future__ import annotations

import contextlib
import ctypes
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fmpy import calloc, free
from fmpy.fmi2 import (
    FMU2Model,
    FMU2Slave,
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
)
from fmpy.fmi3 import FMU3Model, FMU3Slave
from fmpy.logging import addLoggerProxy

from aero_bayes.simulation.model_description import ModelDescription
from aero_bayes.simulation.worker_group import LoadError

#: Least status of a log message that tells of trouble: a warning.
TROUBLE = 1


class _Fmi2Names:
    """The methods of FMI 2.0 that have another name in FMI 3.0."""

    def setupExperiment(self, startTime: float = 0.0) -> None:
        self._begin = startTime

    def enterInitializationMode(self) -> None:
        super().enterInitializationMode(startTime=self._begin)  # type: ignore[misc]

    def setReal(self, references: list[int], values: list[float]) -> None:
        self.setFloat64(references, values)  # type: ignore[attr-defined]

    def getReal(self, references: list[int]) -> Any:
        return self.getFloat64(references)  # type: ignore[attr-defined]

    def getInteger(self, references: list[int]) -> Any:
        return self.getInt32(references)  # type: ignore[attr-defined]

    def newDiscreteStates(self) -> Any:
        return self.updateDiscreteStates()  # type: ignore[attr-defined]

    def getDerivatives(self, pointer: Any, size: int) -> None:
        self.getContinuousStateDerivatives(pointer, size)  # type: ignore[attr-defined]


class _Model3(_Fmi2Names, FMU3Model):  # type: ignore[misc]
    pass


class _Slave3(_Fmi2Names, FMU3Slave):  # type: ignore[misc]
    def doStep(self, time: float, step: float) -> None:
        _, stop, early, reached = super().doStep(time, step)
        if stop or (early and reached < time + step):
            raise RuntimeError("the FMU ended the step early")


def open_fmu(model: ModelDescription, folder: Path, tell: Callable[[str], object] = str) -> Any:
    """Load and instantiate a model unpacked into a folder; ``tell`` gets what it logs of trouble."""

    def logged(status: int, message: bytes) -> None:
        if status >= TROUBLE:
            tell(" ".join(message.decode(errors="replace").split()))

    slave = model.interface == "co-simulation"
    kind = {(2, False): FMU2Model, (2, True): FMU2Slave, (3, False): _Model3, (3, True): _Slave3}
    path = str(model.binary_in(folder))
    try:
        with contextlib.chdir("."):  # FMPy stays in the binary's folder where loading fails
            fmu = kind[model.fmi_version, slave](
                guid=model.guid,
                unzipDirectory=str(folder),
                modelIdentifier=model.identifier,
                instanceName=model.identifier,
                libraryPath=path,
            )
    except Exception as error:  # FMPy raises no class of its own
        reason = error.__context__ if isinstance(error.__context__, OSError) else error
        if not isinstance(reason, OSError | AttributeError):
            raise
        raise LoadError(str(reason).removeprefix(f"{path}: ")) from error
    if model.fmi_version == 3:
        fmu.instantiate(logMessage=lambda _environment, status, _category, message: logged(status, message))
        return fmu
    callbacks = fmi2CallbackFunctions()
    callbacks.logger = fmi2CallbackLoggerTYPE(lambda _fmu, _name, status, _category, message: logged(status, message))
    callbacks.allocateMemory = fmi2CallbackAllocateMemoryTYPE(calloc)
    callbacks.freeMemory = fmi2CallbackFreeMemoryTYPE(free)
    with contextlib.suppress(OSError):  # without the proxy, messages keep their format
        addLoggerProxy(ctypes.byref(callbacks))
    fmu.instantiate(callbacks=callbacks)
    return fmu
