"""One running instance of an FMU for Co-Simulation, FMI 2.0 or 3.0, which begins anew from any state and takes steps.

A state is put in by start values before the initialisation, or after it where a slave takes it then alone. Each start
is initialised anew: a saved state may be restored, but not changed.
"""

from __future__ import annotations

from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from casadi_skin.fmu.description import (
    REAL_TYPES,
    Array,
    Element,
    Group,
    Unpacked,
    Variables,
    check_numbers,
    chosen,
    elements_of,
)
from casadi_skin.fmu.fmu_component import call_error, instantiated, refused
from casadi_skin.follow.space import BoundaryError
from casadi_skin.model.arguments import check_name

SAME_VALUE_RTOL = 1e-9  # between what is put in and what is there then; and between times
PUT_IN = 1e-3  # of a state's size, from its start value, by which it is tried whether states can be put in


class SlaveError(BoundaryError):
    """A slave does not answer, or not as it must; in one line."""


@dataclass(frozen=True, eq=False)
class SlaveVariables(Variables):
    """The numbers of an FMU for Co-Simulation; its states are those of ModelStructure unless a script names them."""

    def __post_init__(self) -> None:
        for variable in self.description.modelVariables:
            check_numbers(self.path, variable)
        _ = self.states, self.put, self.given

    @cached_property
    def states(self) -> tuple[Element, ...]:
        """States in the order of the script, or of the FMU."""
        entries = self.description.derivatives
        named = tuple(e for u in entries if u.variable.derivative for e in elements_of(u.variable.derivative))
        if self.choices.states is not None:
            return tuple(chosen("states", self.choices.states, self._reals))
        if not named:
            raise ValueError(f"{self.path}: no states are named in its ModelStructure; accepted: states=[...]")
        return named

    @property
    def _reals(self) -> list[Any]:
        return [variable for variable in self.description.modelVariables if variable.type in REAL_TYPES]

    @cached_property
    def put(self) -> tuple[Element, ...]:
        """The variables that states are put in by."""
        names, others = [state.name for state in self.states], dict(self.choices.starts)
        for name in others:
            check_name("starts", name, names)
        return tuple(chosen("starts", [others.get(name, name) for name in names], self._reals))


class Slave:
    """The one running instance of an FMU for Co-Simulation, which begins anew from any state.

    Methods raise SlaveError where it does not answer; `begin` may be called then.
    """

    def __init__(self, unpacked: Unpacked, variables: SlaveVariables, complaints: deque[str]) -> None:
        self._unpacked, self._variables, self._complaints = unpacked, variables, complaints
        description = unpacked.description
        self._two = str(description.fmiVersion).startswith("2")
        self._states, self._put, self._given = map(Group.of, (variables.states, variables.put, variables.given))
        known = [v for v in description.modelVariables if v.causality == "independent"]
        self._clock = [int(v.valueReference) for v in known[:1]]  # the variable that is the time, where there is one
        self._fmu: Any = None
        self._resets = True  # whether a reset leads back to what a new instance is
        self._late = False  # whether states are put in after the initialisation

    def free(self) -> None:
        """Free the instance, and the library with it."""
        if self._fmu is not None:
            self._fmu.freeInstance()
            self._fmu = None

    def begin(self, x: Array, given: Array, tolerance: float) -> None:
        """Initialise it at time 0 with a state, and values of parameters and inputs."""
        try:
            self._anew()
            if self._two:
                self._fmu.setupExperiment(tolerance=tolerance, startTime=0.0)
            self.give(given)
            if not self._late:
                self._set(self._put, x)
            times = {} if self._two else {"tolerance": tolerance, "startTime": 0.0}
            self._fmu.enterInitializationMode(**times)
            self._fmu.exitInitializationMode()
            if self._late:
                self._set(self._put, x)
        except Exception as error:
            self.free()
            raise self._failed("it cannot be initialised", error) from error
        there = self.states(0.0)
        sizes = np.maximum(np.abs(x), [state.size for state in self._variables.states])
        for name, put, got, size in zip(self._variables.states, x, there, sizes, strict=True):
            if not abs(got - put) <= SAME_VALUE_RTOL * size:
                words = f"the state {name.name} is {got:.9g} after the initialisation, where {put:.9g} was put in"
                raise self._failed(
                    f"{words}; accepted: states that start values set, or starts= with variables that set them", None
                )

    def _anew(self) -> None:
        """An instance that nothing has been done to."""
        if self._fmu is not None and self._resets:
            with suppress(call_error()):
                self._fmu.reset()
                return
        self.free()
        self._fmu = instantiated(self._unpacked, self._complaints)

    def give(self, given: Array) -> None:
        """Values of parameters and inputs."""
        if given.size:
            self._set(self._given, given)

    def advance(self, time: float, step: float) -> Array:
        """The states after a communication step."""
        try:
            said = self._fmu.doStep(time, step)
        except call_error() as error:
            raise self._failed(f"its step from t = {time:.6g} by {step:.6g} is not done", error) from error
        if said and (said[1] or said[2]):  # of FMI 3.0: the end of the simulation, an early return
            raise self._failed(f"it ends or comes back early in its step from t = {time:.6g}", None)
        return self.states(time + step)

    def states(self, time: float) -> Array:
        """The states, at a time that must be the slave's own."""
        get = self._fmu.getReal if self._two else self._fmu.getFloat64
        references, size = [*self._states.references.tolist(), *self._clock], self._states.starts.size
        try:
            found = np.array(get(references, *(() if self._two else (size + len(self._clock),))))
        except call_error() as error:
            raise self._failed(f"its states cannot be had at t = {time:.6g}", error) from error
        if self._clock and abs(found[-1] - time) > SAME_VALUE_RTOL * max(abs(time), 1e-3 * abs(found[-1]), 1e-12):
            words = f"it is at t = {found[-1]:.9g} after a step to {time:.9g}"
            raise self._failed(f"{words}; accepted: steps that are multiples of its own", None)
        if not np.all(np.isfinite(found)):
            raise self._failed(f"a state is not finite at t = {time:.6g}", None)
        return np.asarray(found[self._states.places])

    def _set(self, group: Group, values: Array) -> None:
        entries = group.spread(values[None], group.starts)[0].tolist()
        (self._fmu.setReal if self._two else self._fmu.setFloat64)(group.references.tolist(), entries)

    def _failed(self, what: str, error: Exception | None) -> SlaveError:
        return SlaveError(str(refused(self._unpacked.path, what, error, self._complaints)))

    def tried(self, given: Array, tolerance: float, step: float) -> None:
        """Find how a state is put in, and whether a reset leads back; raises SlaveError where none can be put in."""
        start, beside = (np.array([s.start + k * PUT_IN * s.size for s in self._variables.states]) for k in (0.0, 1.0))
        try:
            self.begin(beside, given, tolerance)
        except SlaveError as error:
            self._late = True
            try:
                self.begin(beside, given, tolerance)
            except SlaveError:
                raise error from None
        self.free()  # the first of the two that are compared is new
        reached = list[Array]()
        for _ in range(2):
            self.begin(start, given, tolerance)
            reached.append(self.advance(0.0, step))
        self._resets = bool(np.array_equal(reached[0], reached[1]))
