"""One running instance of an FMU for Model Exchange: the C interfaces of FMI 2.0 and 3.0 behind one set of names.

Calls at every evaluation go to the binary's functions as fmpy has loaded and typed them.
"""

from __future__ import annotations

import copy
import ctypes
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.fmu.fmu_archive import Unpacked
from casadi_skin.fmu.fmu_variables import Array, Element, Group

MOST_EVENT_ITERATIONS = 100
MOST_COMPLAINTS = 20
_WARNING_STATUS = 1  # the last status of values that are there, in FMI 2.0 and 3.0
DISCARD_STATUS = 2  # the status of values that cannot be computed


class CallError(Exception):
    """A call of the binary that failed; `discarded` where only its values cannot be computed."""

    def __init__(self, function: str, status: int) -> None:
        words = {2: "discard", 3: "error", 4: "fatal"}.get(status, "unknown")
        super().__init__(f"{function} failed with status {status} ({words}).")
        self.discarded = status == DISCARD_STATUS


@dataclass(frozen=True, eq=False)
class Loaded:
    """A binary that fmpy has loaded, and where its messages go; raises ValueError, in one line, where it cannot be."""

    unpacked: Unpacked
    fmu: Any
    complaints: list[str]

    @classmethod
    def of(cls, unpacked: Unpacked) -> Loaded:
        """Load the binary of this platform."""
        from fmpy.fmi2 import FMU2Model
        from fmpy.fmi3 import FMU3Model

        description, here, complaints = unpacked.description, Path.cwd(), list[str]()
        two = str(description.fmiVersion).startswith("2")
        try:
            fmu = (FMU2Model if two else FMU3Model)(
                guid=description.guid if two else description.instantiationToken,
                modelIdentifier=description.modelExchange.modelIdentifier,
                unzipDirectory=str(unpacked.folder),
                libraryPath=str(unpacked.library),
            )
        except Exception as error:  # fmpy raises whatever the loader meets
            raise refused(unpacked.path, "its binary cannot be loaded", error, complaints) from error
        finally:
            os.chdir(here)  # fmpy goes into the library's folder, and stays there when the loader fails
        return cls(unpacked, fmu, complaints)

    @property
    def two(self) -> bool:
        """Whether this is FMI 2.0, not 3.0."""
        return str(self.unpacked.description.fmiVersion).startswith("2")

    def instantiated(self) -> Any:
        """A copy of fmpy's object with an instance of its own."""
        fmu, complaints = copy.copy(self.fmu), self.complaints

        # The message is last in FMI 2.0 and 3.0. The callback must not keep the instance alive.
        def keep(*arguments: Any) -> None:
            complain(complaints, bytes(arguments[-1] or b"").decode(errors="replace"))

        if self.two:
            fmu.instantiate(callbacks=_callbacks(keep))
        else:
            fmu.instantiate(logMessage=keep)
        return fmu


class Component:
    """An instance of a binary with the values of the parameters `held`, at a time, a state and inputs `moved`.

    Methods raise `CallError` where the binary does not answer; then `restart` is called before anything else.
    """

    def __init__(self, loaded: Loaded, states: int, held: tuple[Element, ...], moved: tuple[Element, ...]) -> None:
        self._loaded, self._two, self._fmu = loaded, loaded.two, loaded.instantiated()
        self._held, self._moved = Values.of(Group.of(held)), Values.of(Group.of(moved))
        self._tunable = all(element.tunable for element in held)
        self._n, dll = states, self._fmu.dll
        self._fresh = True  # instantiated, and nothing else
        number, count, here = ctypes.c_double, ctypes.c_size_t, ctypes.c_void_p
        some, sized = (ctypes.POINTER(ctypes.c_uint32), count), (here,) if self._two else (here, count)
        prefix, real = ("fmi2", "Real") if self._two else ("fmi3", "Float64")
        rates = "GetDerivatives" if self._two else "GetContinuousStateDerivatives"
        self._set_time = _function(dll, f"{prefix}SetTime", number)
        self._set_states = _function(dll, f"{prefix}SetContinuousStates", here, count)
        self._get_rates = _function(dll, f"{prefix}{rates}", here, count)
        self._get = _function(dll, f"{prefix}Get{real}", *some, *sized)
        self._set = _function(dll, f"{prefix}Set{real}", *some, *sized)
        self._seeded = _function(dll, f"{prefix}GetDirectionalDerivative", *some, *some, *sized, *sized)

    def free(self) -> None:
        """Free the instance; it is not used any more."""
        self._release()

    # Parameters -------------------------------------------------------------------------------------------------------

    def restart(self, held: Array) -> None:
        """Initialise it anew with values of its parameters, and go to Continuous-Time Mode."""
        fmu = self._fmu
        if not self._fresh and _failed(fmu.reset):
            self._release()
            self._fmu = fmu = self._loaded.instantiated()
        self._fresh = False
        self._call(self._restarted, fmu, held)

    def _restarted(self, fmu: Any, held: Array) -> None:
        if self._two:
            fmu.setupExperiment(startTime=0.0)
        self._give(self._held, held)
        if self._two:
            fmu.enterInitializationMode()
        else:
            fmu.enterInitializationMode(startTime=0.0)
        fmu.exitInitializationMode()
        self._events()
        fmu.enterContinuousTimeMode()

    def change(self, held: Array) -> None:
        """Give it other values of its parameters: at an event where they are tunable, else from the start."""
        if not self._tunable:
            self.restart(held)
            return
        self._call(self._tuned, held)

    def _tuned(self, held: Array) -> None:
        self._fmu.enterEventMode()
        self._give(self._held, held)
        self._events()
        self._fmu.enterContinuousTimeMode()

    def _events(self) -> None:
        """Iterate events until none is left."""
        for _ in range(MOST_EVENT_ITERATIONS):
            update = self._fmu.newDiscreteStates if self._two else self._fmu.updateDiscreteStates
            again, stop, _, _, timed, _ = update()
            if stop or timed:
                raise ValueError("it has events at times, or ends by itself; accepted: a model without events")
            if not again:
                return
        raise ValueError("its events do not end")

    def _call(self, function: Callable[..., None], *arguments: Any) -> None:
        """Call a function that goes through fmpy, whose error has the status."""
        from fmpy.fmi1 import FMICallException

        try:
            function(*arguments)
        except FMICallException as error:
            raise CallError(error.function, error.status) from error

    def _release(self) -> None:
        (self._fmu.fmi2FreeInstance if self._two else self._fmu.fmi3FreeInstance)(self._fmu.component)

    # Values -----------------------------------------------------------------------------------------------------------
    # Points and results are given as addresses of doubles: calls at every node make no objects.

    def place(self, t: float, x: int, inputs: Array | None) -> None:
        """Go to a time, a state and inputs."""
        instance = self._fmu.component
        if (status := self._set_time(instance, t)) > _WARNING_STATUS:
            raise CallError("SetTime", status)
        if (status := self._set_states(instance, x, self._n)) > _WARNING_STATUS:
            raise CallError("SetContinuousStates", status)
        if inputs is not None:
            self._give(self._moved, inputs)

    def rates(self, result: int) -> None:
        """The derivatives of the states."""
        if (status := self._get_rates(self._fmu.component, result, self._n)) > _WARNING_STATUS:
            raise CallError("GetDerivatives", status)

    def states(self) -> Array:
        """The state that it has."""
        name, found = f"fmi{2 if self._two else 3}GetContinuousStates", Buffer(1, self._n)
        get = _function(self._fmu.dll, name, ctypes.c_void_p, ctypes.c_size_t)
        _check(name, get(self._fmu.component, found.address, self._n))
        return np.array(found.array[0])

    def values(self, wanted: Values, result: int) -> None:
        """Values of some variables, of all their entries."""
        extra = () if self._two else (wanted.size,)
        _check("GetReal", self._get(self._fmu.component, wanted.references, wanted.count, result, *extra))

    def directional(self, unknowns: Values, knowns: Values, seed: int, result: int) -> None:
        """Derivatives of all entries of `unknowns` along one seed, a number for each entry of `knowns`."""
        places = (unknowns.references, unknowns.count, knowns.references, knowns.count)
        numbers = (seed, result) if self._two else (seed, knowns.size, result, unknowns.size)
        _check("GetDirectionalDerivative", self._seeded(self._fmu.component, *places, *numbers))

    def _give(self, to: Values, given: Array) -> None:
        """Set numbers; entries of the same arrays that are not given keep their start values."""
        if to.count:
            to.numbers[to.places] = given
            extra = () if self._two else (to.size,)
            _check("SetReal", self._set(self._fmu.component, to.references, to.count, to.address, *extra))


@dataclass(frozen=True, eq=False)
class Values:
    """Variables by their references as an array of C, with `numbers` for all their entries, and their address."""

    group: Group
    references: Any
    numbers: Array
    address: int

    @classmethod
    def of(cls, group: Group) -> Values:
        """With the start values."""
        count, numbers = len(group.references), group.starts.copy()
        return cls(group, (ctypes.c_uint32 * count)(*group.references), numbers, int(numbers.ctypes.data))

    @property
    def count(self) -> int:
        """Number of variables."""
        return len(self.references)

    @property
    def size(self) -> int:
        """Number of their entries."""
        return int(self.numbers.size)

    @property
    def places(self) -> NDArray[np.int64]:
        """Places of the requested numbers among the entries."""
        return self.group.places


class Buffer:
    """Rows of doubles that C and numpy share, with their address and the bytes from one row to the next."""

    def __init__(self, rows: int, columns: int) -> None:
        self.array: Array = np.zeros((rows, columns))
        self.address, self.stride = int(self.array.ctypes.data), int(self.array.strides[0])


def _function(dll: Any, name: str, *types: Any) -> Any:
    """A function of the binary that takes addresses as numbers; fmpy's own objects stay as they are."""
    found = dll[name]
    found.argtypes, found.restype = (ctypes.c_void_p, *types), ctypes.c_int
    return found


def _check(function: str, status: int) -> None:
    if status > _WARNING_STATUS:
        raise CallError(function, status)


def _failed(function: Callable[[], object]) -> bool:
    from fmpy.fmi1 import FMICallException

    try:
        function()
    except FMICallException:
        return True
    return False


def complain(complaints: list[str], message: str) -> None:
    """Add a message to the last ones."""
    complaints.append(message)
    del complaints[:-MOST_COMPLAINTS]


def refused(path: Path, what: str, error: Exception | None, complaints: list[str]) -> ValueError:
    """A refusal in one line, with an error and the last messages."""
    words = " ".join(f"{error or ''} {'; '.join(complaints[-3:])}".split())
    return ValueError(f"{path}: {what}{': ' if words else ''}{words[:300]}")


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
