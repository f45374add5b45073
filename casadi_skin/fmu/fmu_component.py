"""One running instance of an FMU for Model Exchange: the C interfaces of FMI 2.0 and 3.0 behind one set of names.

fmpy has loaded and typed the binary's functions, and raises its `FMICallException`, with the status, where one fails.
Numbers at several points are those of one call of the kernel in native/fmus.c, or of fmpy's functions point by point.
"""

from __future__ import annotations

import ctypes
import itertools
import os
from collections import deque
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from casadi_skin.fmu.description import Array, Group, Unpacked, Variables, fmpy_package
from casadi_skin.native import Indices, Structure, kernels

MOST_EVENT_ITERATIONS = 100
MOST_COMPLAINTS = 20
DISCARD_STATUS = 2  # the status of values that cannot be computed
COMPONENT_FUNCTIONS = (  # the first ones in the order of native/fmus.c
    "SetTime", "SetContinuousStates", "Set", "GetDerivatives", "Get", "GetDirectionalDerivative", "GetEventIndicators",
    "GetContinuousStates", "Reset",
)  # fmt: skip
COMPONENT, GROUP = "iiiiiiiiii", "iia"
POINTS = "aaa" + 3 * GROUP + "i" + "iaa" + "iaa" + "a"
MOST_POINTS, MOST_NUMBERS = 256, 1 << 20  # of one call, whose numbers stay in the memory of points
NONE = Group.of(())
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
        return make(folder, unpacked.description, unpacked.kind, logger=keep, library_path=library)
    except Exception as error:  # fmpy raises whatever the loader meets, and a bare one where there is no instance
        loaded = str(error).startswith("Failed to instantiate")
        what = "it cannot be instantiated" if loaded else "its binary cannot be loaded"
        raise refused(unpacked.path, what, error, complaints) from error
    finally:
        os.chdir(here)  # fmpy goes into the library's folder, and stays there when the loader fails


class Component:
    """An instance of a binary with values of its parameters that a model has too, at a time, a state and inputs.

    Methods raise fmpy's error where the binary does not answer; then `restart` is called before anything else.
    """

    def __init__(self, unpacked: Unpacked, complaints: deque[str], variables: Variables) -> None:
        self._unpacked, self._complaints, self._n = unpacked, complaints, len(variables.states)
        self._two = str(unpacked.description.fmiVersion).startswith("2")
        self._held = Group.of(variables.held)
        # An event elsewhere than at the start would decide anew by which equations it goes on.
        self._tunable = all(element.tunable for element in variables.held) and not variables.indicators
        # Event indicators at the start; zeros are negative in FMI.
        self.positive = np.zeros(len(variables.indicators), dtype=bool)
        self._instantiate()

    def _instantiate(self) -> None:
        """Make an instance of the binary, with the functions of the standard for it by their common names."""
        fmu = self._fmu = instantiated(self._unpacked, self._complaints)
        prefix, real, rates = ("fmi2", "Real", "") if self._two else ("fmi3", "Float64", "ContinuousState")
        renamed = {"Get": f"Get{real}", "Set": f"Set{real}", "GetDerivatives": f"Get{rates}Derivatives"}
        self._names = {name: prefix + renamed.get(name, name) for name in COMPONENT_FUNCTIONS}
        self._fmi = {name: partial(getattr(fmu, full), fmu.component) for name, full in self._names.items()}
        places = [_place(getattr(fmu.dll, full, None)) for full in self._names.values()]
        self._compiled = Structure(COMPONENT, 2 if self._two else 3, self._n, fmu.component, *places[:7])
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
        self._give(self._held, self._held.spread(held[None], self._held.starts)[0])
        self._fmu.enterInitializationMode(**({} if self._two else {"startTime": 0.0}))
        self._fmu.exitInitializationMode()
        self._events()
        self._fmu.enterContinuousTimeMode()
        found = np.zeros(self.positive.size)
        if found.size:
            self._fmi["GetEventIndicators"](_pointer(found), found.size)
        self.positive = found > 0.0

    def change(self, held: Array) -> None:
        """Give it other values of its parameters: at an event where they are tunable, else from the start."""
        if not self._tunable:
            self.restart(held)
            return
        self._fmu.enterEventMode()
        self._give(self._held, self._held.spread(held[None], self._held.starts)[0])
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

    # Values -----------------------------------------------------------------------------------------------------------

    def compute(self, at: Points, first: int, last: int) -> None:
        """The numbers of points `first` to before `last`; raises fmpy's error at point `at.failed[0]`."""
        if not kernels():
            self._computed_by_fmpy(at, first, last)
        elif kernels()["fmu_at"](self._compiled, at.compiled, first, last):
            _, function, status = at.failed.tolist()
            raise call_error()(self._names[COMPONENT_FUNCTIONS[function]], status)

    def _computed_by_fmpy(self, at: Points, first: int, last: int) -> None:
        for row in range(first, last):
            at.failed[0] = row
            self._fmi["SetTime"](at.t[row])
            self._fmi["SetContinuousStates"](_pointer(at.x[row]), self._n)
            self._give(at.moved, at.inputs[row])
            if at.indicators:
                self._fmi["GetEventIndicators"](_pointer(at.result), at.indicators)
            elif at.wanted is None:
                self._fmi["GetDerivatives"](_pointer(at.result), self._n)
            elif not len(at.seeds):
                self._fmi["Get"](*at.wanted.named, *self._counted(at.result))
            else:
                for seed, result in zip(at.seeds, at.result, strict=True):
                    counted = (*self._counted(seed), *self._counted(result))
                    self._fmi["GetDirectionalDerivative"](*at.wanted.named, *at.known.named, *counted)
            at.numbers[row] = at.result.ravel()[at.pick]

    def states(self) -> Array:
        """The state that it has."""
        found = np.zeros(self._n)
        self._fmi["GetContinuousStates"](_pointer(found), self._n)
        return found

    def _give(self, to: Group, numbers: Array) -> None:
        if to.references.size:
            self._fmi["Set"](*to.named, *self._counted(numbers))

    def _counted(self, numbers: Array) -> tuple[Any, ...]:
        """Numbers for C, with how many there are, which FMI 3.0 asks for beside the number of variables."""
        return (_pointer(numbers),) if self._two else (_pointer(numbers), numbers.size)


class Points:
    """Doubles that a binary shares: times, states and inputs `moved` of several points, and `numbers` of each.

    These are parts of the values of the variables `wanted`, or of the derivatives of the states where that is None, or,
    along `seeds`, numbers for each entry of the variables `known`, of derivatives along each; or so many `indicators`,
    where there are any. Of the first point, with parameters and inputs `p`, `given` are its bytes, and `parts` those of
    its numbers.
    """

    def __init__(
        self, sizes: tuple[int, int], moved: Group, wanted: Group | None, known: Group, seeds: Array | None,
        parts: Sequence[Indices], indicators: int,
    ) -> None:  # fmt: skip
        states, parameters = sizes
        self.indicators = indicators
        self.wanted, self.known, self.moved = wanted, known, moved
        self.pick = np.concatenate([np.zeros(0, dtype=np.int64), *parts])
        rows = self.rows = max(1, min(MOST_POINTS, MOST_NUMBERS // (states + parameters + self.pick.size)))
        self.t, self.x, self.p = np.zeros(rows), np.zeros((rows, states)), np.zeros((rows, parameters))
        self.inputs = np.tile(moved.starts, (rows, 1))
        self.seeds = np.zeros((0, known.starts.size)) if seeds is None else seeds
        size = indicators or (states if wanted is None else wanted.starts.size)
        self.result = np.zeros((len(self.seeds) or 1, size))
        self.numbers, self.failed = np.zeros((rows, self.pick.size)), np.zeros(3, dtype=np.int64)
        self.given = [array.view(np.uint8).data for array in (self.t[:1], self.x[0], self.p[0])]
        self.ends = list(itertools.accumulate(places.size for places in parts))
        self.parts = [part.view(np.uint8).data for part in np.split(self.numbers[0], self.ends[:-1])]
        groups = [(g.references.size, g.starts.size, g.references) for g in (moved, wanted or NONE, known)]
        along = indicators, len(self.seeds), self.seeds, self.result
        data = *itertools.chain(*groups), *along, self.pick.size, self.pick, self.numbers, self.failed
        self.compiled = Structure(POINTS, self.t, self.x, self.inputs, *data)


def _pointer(numbers: Array) -> Any:
    return numbers.ctypes.data_as(_Doubles)


def _place(function: Any) -> int:
    """Where a function of the binary is; 0 where it has none."""
    return 0 if function is None else ctypes.cast(function, ctypes.c_void_p).value or 0


def refused(path: Path, what: str, error: Exception | None, complaints: deque[str]) -> ValueError:
    """A refusal in one line, with an error and the last messages."""
    words = " ".join(f"{error or ''} {'; '.join(list(complaints)[-3:])}".split())
    return ValueError(f"{path}: {what}{': ' if words else ''}{words[:300]}")
