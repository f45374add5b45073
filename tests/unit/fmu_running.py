"""What tests of FMUs share: instances run through fmpy, initialised or between two communication points."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Model, FMU2Slave
from fmpy.fmi3 import FMU3Model, FMU3Slave
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Running:
    """An FMU of either version behind one set of names; `messages` are what it told its environment."""

    def __init__(self, folder: Path, kind: str) -> None:
        self.description = read_model_description(folder)
        self.two = self.description.fmiVersion == "2.0"
        self.cosimulation = kind == "CoSimulation"
        cls = (
            (FMU2Slave if self.cosimulation else FMU2Model)
            if self.two
            else (FMU3Slave if self.cosimulation else FMU3Model)
        )
        token = self.description.guid if self.two else self.description.instantiationToken
        self.fmu = cls(
            guid=token, modelIdentifier=self.description.modelExchange.modelIdentifier, unzipDirectory=str(folder)
        )
        self.messages: list[str] = []
        if self.two:
            self.fmu.instantiate(callbacks=self._callbacks(), loggingOn=True)
        else:
            self.fmu.instantiate(loggingOn=True, logMessage=lambda *a: self.messages.append(a[-1].decode()))
        self.reference = {v.name: v.valueReference for v in self.description.modelVariables}
        self.states = [e.variable.derivative.name for e in self.description.derivatives]

    def _callbacks(self) -> Any:
        from fmpy import calloc, fmi2, free

        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(lambda *a: self.messages.append(a[-1].decode()))
        callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(calloc)
        callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(free)
        return callbacks

    def initialise(self, tolerance: float | None = None, start_time: float = 0.0) -> None:
        if self.two:
            self.fmu.setupExperiment(tolerance=tolerance, startTime=start_time)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(tolerance=tolerance, startTime=start_time)
        self.fmu.exitInitializationMode()

    def set(self, **values: float) -> None:
        references = [self.reference[name] for name in values]
        (self.fmu.setReal if self.two else self.fmu.setFloat64)(references, list(values.values()))

    def get(self, *names: str) -> Array:
        references = [self.reference[name] for name in names]
        return np.array((self.fmu.getReal if self.two else self.fmu.getFloat64)(references))

    def place(self, x: Array) -> None:
        """Set all continuous states, in Event Mode as in Continuous-Time Mode."""
        pointer = x.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
        (self.fmu.fmi2SetContinuousStates if self.two else self.fmu.fmi3SetContinuousStates)(
            self.fmu.component, pointer, len(x)
        )

    def step(self, start: float, size: float) -> Any:
        return self.fmu.doStep(currentCommunicationPoint=start, communicationStepSize=size)

    def directional(self, unknowns: list[str], knowns: list[str], seed: Array) -> Array:
        call = self.fmu.getDirectionalDerivative
        return np.array(call(*([self.reference[n] for n in names] for names in (unknowns, knowns)), list(seed)))

    def state(self) -> Any:
        return self.fmu.getFMUstate() if self.two else self.fmu.getFMUState()

    def restore(self, state: Any) -> None:
        (self.fmu.setFMUstate if self.two else self.fmu.setFMUState)(state)

    def free_state(self, state: Any) -> None:
        (self.fmu.freeFMUstate if self.two else self.fmu.freeFMUState)(state)

    def serialised(self, state: Any) -> bytes:
        return bytes((self.fmu.serializeFMUstate if self.two else self.fmu.serializeFMUState)(state))

    def deserialised(self, data: bytes) -> Any:
        return (self.fmu.deSerializeFMUstate if self.two else self.fmu.deserializeFMUState)(data)


@contextmanager
def running(path: Path, folder: Path, kind: str = "ModelExchange") -> Iterator[Running]:
    """An instance of the FMU, unpacked in a folder unless that was done before."""
    if not (folder / "modelDescription.xml").exists():
        extract(str(path), unzipdir=str(folder))
    fmu = Running(folder, kind)
    try:
        yield fmu
    finally:
        fmu.fmu.freeInstance()
