"""One running instance of an FMU for Model Exchange: the C interfaces of FMI 2.0 and 3.0 behind one set of names.

All calls go through fmpy, which has loaded and typed the binary's functions, and raises its `FMICallException`, with
the status, where one fails.
"""

from __future__ import annotations

import ctypes
import os
from collections import deque
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from casadi_skin.fmu.description import Array, Element, Group, Unpacked, fmpy_package

MOST_EVENT_ITERATIONS = 100
MOST_COMPLAINTS = 20
DISCARD_STATUS = 2  # the status of values that cannot be computed
COMPONENT_FUNCTIONS = (
    "Reset", "SetTime", "SetContinuousStates", "GetContinuousStates", "GetDerivatives", "Get", "Set",
    "GetDirectionalDerivative",
)  # fmt: skip
_Doubles = ctypes.POINTER(ctypes.c_double)


def call_error() -> Any:
    """The class of fmpy's errors of calls that fail."""
    from fmpy.fmi1 import FMICallException

    return FMICallException


def instantiated(unpacked: Unpacked, complaints: deque[str]) -> Any:
    """fmpy's object of a new instance of the binary, whose messages become complaints.

    Raises ValueError, in one line, where the binary cannot be loaded, or the instance not be made.
    """

    # The message is last in FMI 2.0 and 3.0. The callback must not keep the instance alive.
    def keep(*arguments: Any) -> None:
        complaints.append(bytes(arguments[-1] or b"").decode(errors="replace"))

    folder, library, here = str(unpacked.folder), str(unpacked.library), Path.cwd()
    make = fmpy_package().instantiate_fmu
    try:
        return make(folder, unpacked.description, "ModelExchange", logger=keep, library_path=library)
    except Exception as error:  # fmpy raises whatever the loader meets, and a bare one where there is no instance
        loaded = str(error).startswith("Failed to instantiate")
        what = "it cannot be instantiated" if loaded else "its binary cannot be loaded"
        raise refused(unpacked.path, what, error, complaints) from error
    finally:
        os.chdir(here)  # fmpy goes into the library's folder, and stays there when the loader fails


class Component:
    """An instance of a binary with the values of the parameters `held`, at a time, a state and inputs `moved`.

    Methods raise fmpy's error where the binary does not answer; then `restart` is called before anything else.
    """

    def __init__(
        self, unpacked: Unpacked, complaints: deque[str], states: int, held: tuple[Element, ...],
        moved: tuple[Element, ...],
    ) -> None:  # fmt: skip
        self._unpacked, self._complaints = unpacked, complaints
        self._two = str(unpacked.description.fmiVersion).startswith("2")
        self._held, self._moved = Group.of(held), Group.of(moved)
        self._numbers = {group: Buffer(group.starts[None]) for group in (self._held, self._moved)}
        self._tunable = all(element.tunable for element in held)
        self._n = states
        self._instantiate()

    def _instantiate(self) -> None:
        """Make an instance of the binary, with the functions of the standard for it by their common names."""
        fmu = self._fmu = instantiated(self._unpacked, self._complaints)
        prefix, real, rates = ("fmi2", "Real", "") if self._two else ("fmi3", "Float64", "ContinuousState")
        renamed = {"Get": f"Get{real}", "Set": f"Set{real}", "GetDerivatives": f"Get{rates}Derivatives"}
        self._fmi = {
            name: partial(getattr(fmu, prefix + renamed.get(name, name)), fmu.component) for name in COMPONENT_FUNCTIONS
        }
        self._fresh = True  # instantiated, and nothing else

    def free(self) -> None:
        """Free the instance, and the library with the last one; it is not used any more."""
        self._fmu.freeInstance()

    # Parameters -------------------------------------------------------------------------------------------------------

    def restart(self, held: Array) -> None:
        """Initialise it anew with values of its parameters, and go to Continuous-Time Mode."""
        if not self._fresh:
            try:
                self._fmi["Reset"]()
            except call_error():
                self.free()
                self._instantiate()
        self._fresh = False
        if self._two:
            self._fmu.setupExperiment(startTime=0.0)
        self._give(self._held, held)
        self._fmu.enterInitializationMode(**({} if self._two else {"startTime": 0.0}))
        self._fmu.exitInitializationMode()
        self._events()
        self._fmu.enterContinuousTimeMode()

    def change(self, held: Array) -> None:
        """Give it other values of its parameters: at an event where they are tunable, else from the start."""
        if not self._tunable:
            self.restart(held)
            return
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

    # Values, in rows of buffers --------------------------------------------------------------------------------------

    def place(self, t: float, x: Any, inputs: Array | None) -> None:
        """Go to a time, a state and inputs."""
        self._fmi["SetTime"](t)
        self._fmi["SetContinuousStates"](x, self._n)
        if inputs is not None:
            self._give(self._moved, inputs)

    def rates(self, result: Any) -> None:
        """The derivatives of the states."""
        self._fmi["GetDerivatives"](result, self._n)

    def states(self) -> Array:
        """The state that it has."""
        found = Buffer(np.zeros((1, self._n)))
        self._fmi["GetContinuousStates"](found.rows[0], self._n)
        return np.array(found.array[0])

    def values(self, wanted: Group, result: Any) -> None:
        """Values of some variables, of all their entries."""
        self._fmi["Get"](*wanted.named, result, *self._counts(wanted))

    def directional(self, unknowns: Group, knowns: Group, seed: Any, result: Any) -> None:
        """Derivatives of all entries of `unknowns` along one seed, a number for each entry of `knowns`."""
        numbers = (seed, *self._counts(knowns), result, *self._counts(unknowns))
        self._fmi["GetDirectionalDerivative"](*unknowns.named, *knowns.named, *numbers)

    def _give(self, to: Group, given: Array) -> None:
        """Set numbers; entries of the same arrays that are not given keep their start values."""
        if to.references:
            numbers = self._numbers[to]
            numbers.array[0, to.places] = given
            self._fmi["Set"](*to.named, numbers.rows[0], *self._counts(to))

    def _counts(self, group: Group) -> tuple[int, ...]:
        """The number of entries, which FMI 3.0 asks for beside that of the variables."""
        return () if self._two else (group.starts.size,)


class Buffer:
    """Rows of doubles that C and numpy share, with a pointer to each row."""

    def __init__(self, values: Array) -> None:
        self.array = np.array(values)
        self.rows = [row.ctypes.data_as(_Doubles) for row in self.array]


def refused(path: Path, what: str, error: Exception | None, complaints: deque[str]) -> ValueError:
    """A refusal in one line, with an error and the last messages."""
    words = " ".join(f"{error or ''} {'; '.join(list(complaints)[-3:])}".split())
    return ValueError(f"{path}: {what}{': ' if words else ''}{words[:300]}")
