"""A running instance of an FMU for Model Exchange: its right-hand side and outputs at any time, state and parameters.

The C interfaces of FMI 2.0 and 3.0 are called through fmpy. States are in the order of the FMU's derivatives.
"""

from __future__ import annotations

import ctypes
import os
import threading
import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.models.fmu_archive import Unpacked

Array = NDArray[np.float64]
MOST_EVENT_ITERATIONS = 100
MOST_COMPLAINTS = 20

_DISCARD = 2  # the status of values that cannot be computed, in FMI 2.0 and 3.0


class FmuInstance:
    """One instance, unpacked in a temporary folder that is removed with it.

    `parameters` are fmpy's variables that are given values; `complaints` the last messages of the FMU. Raises
    ValueError, in one line, where it cannot be loaded or initialised, or has events.
    """

    def __init__(self, unpacked: Unpacked, parameters: Sequence[Any]) -> None:
        self.path, self.folder, self.description = unpacked.path, unpacked.folder, unpacked.description
        self.parameters = tuple(parameters)
        self.complaints: list[str] = []
        self._lock = threading.Lock()  # two threads of a map must not set the one state
        self._given: Array | None = None  # the parameters that it has, None where it is to be initialised
        self._fresh = True  # instantiated, and nothing else
        self._two = str(self.description.fmiVersion).startswith("2")
        self._n = len(self.description.derivatives)
        self._fmu = self._loaded(unpacked)
        self._finalizer = weakref.finalize(self, _close, self._fmu, unpacked.remove)
        self._x, self._result = _Numbers(self._n), _Numbers(self._n)
        self._placed: tuple[float, bytes] | None = None  # time and state that it has
        self._requests: dict[tuple[tuple[int, ...], tuple[int, ...]], _Request] = {}
        self._references = [int(v.valueReference) for v in self.parameters]
        self.start_parameters = np.array([_start(v) for v in self.parameters])
        try:
            self._restart(self.start_parameters)
            self.start = self._states()
        except Exception as error:
            raise self._refused("it cannot be initialised", error) from error

    def close(self) -> None:
        """Free the instance and remove its folder; done when nothing refers to it any more, or at the end."""
        self._finalizer()

    # Values -----------------------------------------------------------------------------------------------------------

    def derivatives(self, t: float, x: Array, p: Array) -> Array:
        """x' at a time, state and parameters; NaN where the FMU cannot compute it."""
        with self._lock:
            if self._move(t, x, p) and self._ask(self._derivatives):
                return self._result.array.copy()
            return np.full(self._n, np.nan)

    def outputs(self, references: tuple[int, ...], t: float, x: Array, p: Array) -> Array:
        """Values of variables by their references; NaN where the FMU cannot compute them."""
        with self._lock:
            request = self._request(references, ())
            if self._move(t, x, p) and self._ask(self._values, request):
                return request.result.array.copy()
            return np.full(len(references), np.nan)

    def directional(
        self, unknowns: tuple[int, ...], knowns: tuple[int, ...], seeds: Array, t: float, x: Array, p: Array
    ) -> Array:
        """Directional derivatives of unknowns, one column a column of `seeds`, shape (unknowns, seeds); NaN where none.

        All knowns are given in each call, most with seed 0: some FMUs go on with seeds of the call before.
        """
        with self._lock:
            result = np.full((len(unknowns), seeds.shape[1]), np.nan)
            request = self._request(unknowns, knowns)
            if self._move(t, x, p):
                for k in range(seeds.shape[1]):
                    request.seed.array[:] = seeds[:, k]
                    if not self._ask(self._directional, request):
                        break
                    result[:, k] = request.result.array
            return result

    def _request(self, unknowns: tuple[int, ...], knowns: tuple[int, ...]) -> _Request:
        """Arrays of C for one set of variables, made once."""
        if (unknowns, knowns) not in self._requests:
            self._requests[unknowns, knowns] = _Request(
                (ctypes.c_uint32 * len(unknowns))(*unknowns),
                (ctypes.c_uint32 * len(knowns))(*knowns),
                _Numbers(len(knowns)),
                _Numbers(len(unknowns)),
            )
        return self._requests[unknowns, knowns]

    # The interface ----------------------------------------------------------------------------------------------------

    def _loaded(self, unpacked: Unpacked) -> Any:
        from fmpy.fmi1 import FMICallException
        from fmpy.fmi2 import FMU2Model
        from fmpy.fmi3 import FMU3Model

        self._call_failed = FMICallException
        description, here = self.description, Path.cwd()
        try:
            fmu = (FMU2Model if self._two else FMU3Model)(
                guid=description.guid if self._two else description.instantiationToken,
                modelIdentifier=description.modelExchange.modelIdentifier,
                unzipDirectory=str(unpacked.folder),
                libraryPath=str(unpacked.library),
            )
        except Exception as error:  # fmpy raises whatever the loader meets
            raise self._refused("its binary cannot be loaded", error) from error
        finally:
            os.chdir(here)  # fmpy goes into the library's folder, and stays there when the loader fails
        try:
            self._instantiate(fmu)
        except Exception as error:
            raise self._refused("it cannot be instantiated", error) from error
        return fmu

    def _instantiate(self, fmu: Any) -> None:
        # The message is last in FMI 2.0 and 3.0. The callback must not keep the instance alive.
        complaints = self.complaints

        def keep(*arguments: Any) -> None:
            _append(complaints, bytes(arguments[-1] or b"").decode(errors="replace"))

        if self._two:
            fmu.instantiate(callbacks=_callbacks(keep))
        else:
            fmu.instantiate(logMessage=keep)

    def _refused(self, what: str, error: Exception | None) -> ValueError:
        words = " ".join(f"{error or ''} {'; '.join(self.complaints[-3:])}".split())
        return ValueError(f"{self.path}: {what}{': ' if words else ''}{words[:300]}")

    def _restart(self, p: Array) -> None:
        """Initialise anew with the given parameters and go to Continuous-Time Mode."""
        fmu = self._fmu
        if not self._fresh:
            try:
                fmu.reset()
            except self._call_failed:
                (fmu.fmi2FreeInstance if self._two else fmu.fmi3FreeInstance)(fmu.component)
                self._instantiate(fmu)
        self._given, self._fresh, self._placed = None, False, None
        if self._two:
            fmu.setupExperiment(startTime=0.0)
        self._set(np.arange(len(self.parameters)), p)
        if self._two:
            fmu.enterInitializationMode()
        else:
            fmu.enterInitializationMode(startTime=0.0)
        fmu.exitInitializationMode()
        self._events()
        fmu.enterContinuousTimeMode()
        self._given = p.copy()

    def _events(self) -> None:
        """Iterate events until none is left."""
        for _ in range(MOST_EVENT_ITERATIONS):
            if self._two:
                again, stop, _, _, timed, _ = self._fmu.newDiscreteStates()
            else:
                again, stop, _, _, timed, _ = self._fmu.updateDiscreteStates()
            if stop or timed:
                raise self._refused("it has events at times, or ends by itself; accepted: a model without events", None)
            if not again:
                return
        raise self._refused("its events do not end", None)

    def _move(self, t: float, x: Array, p: Array) -> bool:
        """Bring the instance to a time, state and parameters; False where it refuses them.

        Raises ValueError after `close`: what would be called is no longer there.
        """
        if not self._finalizer.alive:
            raise ValueError(f"{self.path}: closed; accepted: calls before that")
        if not self._ask(self._parameterise, p):
            self._restart(self.start_parameters)  # it may be left in Event Mode
            return False
        return self._ask(self._place, t, x)

    def _ask(self, function: Any, *arguments: Any) -> bool:
        """Call the FMU; False where it does not answer: then it is initialised anew, unless it only discards values."""
        try:
            function(*arguments)
        except self._call_failed as error:
            self._placed = None
            _append(self.complaints, str(error))
            if error.status != _DISCARD:
                self._restart(self.start_parameters)
            return False
        return True

    def _parameterise(self, p: Array) -> None:
        if self._given is not None and np.array_equal(p, self._given):
            return
        changed = np.arange(len(p)) if self._given is None else np.flatnonzero(p != self._given)
        kinds = {(self.parameters[i].causality, self.parameters[i].variability) for i in changed}
        if self._given is None or any(c == "parameter" and v != "tunable" for c, v in kinds):
            self._restart(p)
        elif all(causality == "input" for causality, _ in kinds):
            self._set(changed, p[changed])
        else:
            self._fmu.enterEventMode()
            self._set(changed, p[changed])
            self._events()
            self._fmu.enterContinuousTimeMode()
        self._given = p.copy()

    def _place(self, t: float, x: Array) -> None:
        there = (t, x.tobytes())
        if self._placed == there:
            return
        fmu = self._fmu
        fmu.setTime(t)
        self._x.array[:] = x
        call = fmu.fmi2SetContinuousStates if self._two else fmu.fmi3SetContinuousStates
        call(fmu.component, self._x.pointer, self._n)
        self._placed = there

    def _set(self, which: NDArray[np.int64], values: Array) -> None:
        self._placed = None
        if len(which):
            references = [self._references[i] for i in which]
            (self._fmu.setReal if self._two else self._fmu.setFloat64)(references, [float(v) for v in values])

    def _states(self) -> Array:
        fmu = self._fmu
        call = fmu.fmi2GetContinuousStates if self._two else fmu.fmi3GetContinuousStates
        call(fmu.component, self._result.pointer, self._n)
        return self._result.array.copy()

    def _derivatives(self) -> None:
        fmu = self._fmu
        call = fmu.fmi2GetDerivatives if self._two else fmu.fmi3GetContinuousStateDerivatives
        call(fmu.component, self._result.pointer, self._n)

    def _values(self, request: _Request) -> None:
        fmu, result = self._fmu, request.result
        if self._two:
            fmu.fmi2GetReal(fmu.component, request.unknowns, result.count, result.pointer)
        else:
            fmu.fmi3GetFloat64(fmu.component, request.unknowns, result.count, result.pointer, result.count)

    def _directional(self, request: _Request) -> None:
        fmu, seed, result = self._fmu, request.seed, request.result
        places = (request.unknowns, result.count, request.knowns, seed.count)
        if self._two:
            fmu.fmi2GetDirectionalDerivative(fmu.component, *places, seed.pointer, result.pointer)
        else:
            fmu.fmi3GetDirectionalDerivative(
                fmu.component, *places, seed.pointer, seed.count, result.pointer, result.count
            )


class _Numbers:
    """An array of doubles that C and numpy share."""

    def __init__(self, count: int) -> None:
        self.count = count
        self.array: Array = np.zeros(count)
        self.pointer = self.array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


@dataclass(frozen=True, eq=False)
class _Request:
    """Value references of unknowns and knowns as arrays of C, with places for seeds and results."""

    unknowns: Any
    knowns: Any
    seed: _Numbers
    result: _Numbers


def _append(complaints: list[str], message: str) -> None:
    complaints.append(message)
    del complaints[:-MOST_COMPLAINTS]


def _start(variable: Any) -> float:
    return float(variable.start if variable.start is not None else 0.0)


def _callbacks(keep: Any) -> Any:
    """FMI 2.0's structure of callbacks with a logger that keeps messages."""
    from fmpy import calloc, fmi2, free
    from fmpy.logging import addLoggerProxy

    callbacks = fmi2.fmi2CallbackFunctions()
    callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(keep)
    callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(calloc)
    callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(free)
    addLoggerProxy(ctypes.byref(callbacks))  # it formats what the FMU prints with C's variable arguments
    return callbacks


def _close(fmu: Any, remove: Callable[[], object]) -> None:
    from fmpy import freeLibrary

    free = getattr(fmu, "fmi2FreeInstance", None) or fmu.fmi3FreeInstance
    free(fmu.component)
    freeLibrary(fmu.dll._handle)
    remove()
