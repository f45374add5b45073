"""An FMU at any time, state, parameters and inputs: several instances of it, one for each set of parameters in use.

To go from one set of parameters to another and back, as differences do at every node, then costs no initialisation.
"""

from __future__ import annotations

import threading
import weakref
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import wraps
from typing import Any, Concatenate

import casadi as ca
import numpy as np

from casadi_skin.fmu.description import Array, Group, Pattern, Unpacked, Variables, nearest_first
from casadi_skin.fmu.fmu_component import DISCARD_STATUS, MOST_COMPLAINTS, NONE, Component, Points, call_error, refused
from casadi_skin.fmu.initial_value_problem import InitialValueProblem
from casadi_skin.model.arguments import short_repr
from casadi_skin.model.expressions import Expression
from casadi_skin.model.interrupts import P, T, holding
from casadi_skin.model.ode import OdeModel
from casadi_skin.native import Indices

SHIFTED_SETS = 6  # sets of values that differences with three steps take for each parameter
MOST_COMPONENTS = 64
Bytes = bytearray | memoryview | None  # CasADi gives None for zeros, and for a result that nobody wants


def _alone(method: Callable[Concatenate[FmuInstance, P], T]) -> Callable[Concatenate[FmuInstance, P], T]:
    """The method, for one thread at a time: two of them must not set the one state."""

    @wraps(method)
    def alone(self: FmuInstance, /, *arguments: P.args, **options: P.kwargs) -> T:
        return holding(self._lock, method, self, *arguments, **options)

    return alone


class FmuInstance:
    """The FMU in its temporary folder, which is removed with it.

    `given` are the variables that get values, in the order of `p` of its methods; states are in the FMU's order.
    `complaints` are the last messages. Raises ValueError, in one line, where it cannot be loaded or initialised, or has
    events in time.
    """

    def __init__(self, unpacked: Unpacked, variables: Variables) -> None:
        self.path, self.unpacked, self.variables, self.given = unpacked.path, unpacked, variables, variables.given
        self._failure = call_error()
        self._lock = threading.Lock()
        self.complaints = deque[str](maxlen=MOST_COMPLAINTS)
        self._moved = np.array([k for k, e in enumerate(self.given) if e.is_input], dtype=int)
        self._held = np.array([k for k, e in enumerate(self.given) if not e.is_input], dtype=int)
        once = unpacked.description.modelExchange.canBeInstantiatedOnlyOncePerProcess
        self._most = 1 if once else min(MOST_COMPONENTS, SHIFTED_SETS * self._held.size + 2)
        self._components: dict[bytes, Component] = {}  # by their parameters
        self._finalizer = weakref.finalize(self, _close, self._components, unpacked.remove)
        self._inputs = Group.of(self.given[k] for k in self._moved)
        count = len(variables.indicators)
        self._indicators = self.points(None, parts=(np.arange(count),), indicators=count)
        self.start_given = np.array([element.start for element in self.given])
        component = Component(unpacked, self.complaints, variables)
        held = self.start_given[self._held]
        self._components[held.tobytes()] = component
        try:
            component.restart(held)
            self.start = component.states()
        except Exception as error:
            raise refused(self.path, "it cannot be initialised", error, self.complaints) from error

    def close(self) -> None:
        """Free the instances and remove the folder; done when nothing refers to it any more, or at the end."""
        self._finalizer()

    # Values -----------------------------------------------------------------------------------------------------------

    def points(
        self, wanted: Group | None, known: Group = NONE, seeds: Array | None = None,
        parts: Sequence[Indices] | None = None, indicators: int = 0,
    ) -> Points:  # fmt: skip
        """Points for numbers of `wanted`, or their directional derivatives along the rows of `seeds`, or indicators.

        A seed has a number for each entry of the knowns' variables: all are given in each call, most with seed 0, as
        some FMUs go on with seeds of the call before.
        """
        states = len(self.variables.states)
        if parts is None:
            parts = (np.arange(states) if wanted is None else wanted.places,)
        along = None if seeds is None else known.spread(seeds)
        return Points((states, len(self.given)), self._inputs, wanted, known, along, parts, indicators)

    @_alone
    def numbers(self, at: Points, t: Array, x: Array, p: Array) -> Array:
        """Those of any number of points, one a row of all of these; NaN where the FMU cannot compute them."""
        found = np.empty((len(t), at.pick.size))
        for first in range(0, len(t), at.rows):
            part = slice(first, first + at.rows)
            rows = len(t[part])
            at.t[:rows], at.x[:rows], at.p[:rows] = t[part], x[part], p[part]
            self._compute(at, rows)
            found[part] = at.numbers[:rows]
        return found

    @_alone
    def answer(self, at: Points, given: Sequence[Bytes], results: Sequence[Bytes]) -> None:
        """Parts of the numbers at one point from views of its time, state and parameters; NaN where one is not had."""
        for own, view in zip(at.given, given, strict=False):
            own[:] = view or bytes(own.nbytes)
        self._compute(at, 1)
        for part, result in zip(at.parts, results, strict=True):
            if result:
                result[:] = part

    def indicators(self, t: Array, x: Array, p: Array) -> tuple[Array, Pattern]:
        """Event indicators at points, one a row of all of these, and which of them are positive at the FMU's start."""
        values = self.numbers(self._indicators, t, x, p)
        known = zip((self._components.get(held.tobytes()) for held in p[:, self._held]), values, strict=True)
        return values, np.array([here > 0.0 if one is None else one.positive for one, here in known])

    def _compute(self, at: Points, rows: int) -> None:
        """The numbers of the first points: those of the same parameters in one call."""
        held, row, ends = at.p[:rows], 0, [rows]
        if self._moved.size:
            at.inputs[:rows, self._inputs.places] = held[:, self._moved]
            held = held[:, self._held]
        if rows > 1:
            ends[:0] = (np.flatnonzero((held[1:] != held[:-1]).any(axis=1)) + 1).tolist()
        for last in ends:
            while row < last:
                row = self._computed(at, row, last, held[row])

    def _computed(self, at: Points, row: int, last: int, held: Array) -> int:
        """The point after the last that was computed, or that the FMU cannot compute."""
        key = held.tobytes()
        component = self._components.get(key) or self._at(key, held)
        if component is None:
            at.numbers[row:last] = np.nan
            return last
        try:
            component.compute(at, row, last)
        except self._failure as error:
            failed = int(at.failed[0])
            at.numbers[failed] = np.nan
            self._failed(component, error)
            return failed + 1
        return last

    # Instances --------------------------------------------------------------------------------------------------------

    def _at(self, key: bytes, held: Array) -> Component | None:
        """An instance that gets the parameters of this key; None where the FMU refuses them.

        Raises ValueError after `close`: what would be called is no longer there.
        """
        if not self._finalizer.alive:
            raise ValueError(f"{self.path}: closed; accepted: calls before that")
        component, start = self._spare()
        try:
            start(held)
        except self._failure as error:
            self._failed(component, error)
            return None
        self._components[key] = component
        return component

    def _spare(self) -> tuple[Component, Callable[[Array], None]]:
        """An instance that is new, or the one that has had its parameters longest; and what gives it others."""
        if len(self._components) < self._most:
            try:
                new = Component(self.unpacked, self.complaints, self.variables)
                return new, new.restart
            except ValueError:  # the instances that there are do as well
                if not self._components:
                    raise
                self._most = len(self._components)
        longest = self._components.pop(next(iter(self._components)))
        return longest, longest.change

    def _failed(self, component: Component, error: Any) -> None:
        """Keep the message; initialise the instance anew unless the FMU only discards values."""
        self.complaints.append(str(error))
        known = next((key for key, other in self._components.items() if other is component), None)
        if error.status == DISCARD_STATUS and known is not None:
            return
        if known is not None:
            del self._components[known]
        held = self.start_given[self._held]
        if held.tobytes() in self._components:
            component.free()
            return
        try:
            component.restart(held)
        except self._failure as again:
            component.free()
            raise refused(self.path, "it cannot be initialised again", again, self.complaints) from again
        self._components[held.tobytes()] = component


def _close(components: dict[bytes, Component], remove: Callable[[], object]) -> None:
    for component in components.values():
        component.free()
    components.clear()
    remove()


# Inputs of an FMU: forces on the sites of a chain, a lattice or a model of second order, and named parameters ---------


@dataclass(frozen=True, eq=False)
class Force:
    """A force on a site: it adds `factor` times itself to the derivative of the state number `row`."""

    row: int
    factor: Expression | float
    meaning: str


def with_inputs(problem: InitialValueProblem, names: object) -> InitialValueProblem:
    """The problem with some numbers as inputs, which are the last of its parameters; forces start from 0.

    Raises:
        TypeError: `names` is no list of names.
        ValueError: A name is neither that of a force nor of a parameter, or is there twice.
    """
    if isinstance(names, str) or not isinstance(names, Sequence) or not all(isinstance(name, str) for name in names):
        raise TypeError(f"inputs: given {short_repr(names)}; accepted: a list of names")
    known = dict(zip(problem.model.parameter_names, problem.parameters, strict=True))
    forces = forces_of(problem)
    for i, name in enumerate(names):
        if name in names[:i]:
            raise ValueError(f"inputs: given {name!r} twice; accepted: each name once")
        if name not in known and name not in forces:
            listed = nearest_first(name, [*known, *forces], "none, the model has neither forces nor parameters")
            raise ValueError(f"inputs: given {name!r}; accepted: {listed}")
    if not names:
        return problem
    held = [name for name in known if name not in names]
    values = known | dict.fromkeys((name for name in names if name not in known), 0.0)
    chosen = {name: force for name, force in forces.items() if name in names and name not in known}
    model = _forced(problem.model, (*held, *names), chosen)
    meanings = dict(problem.meanings) | {name: force.meaning for name, force in chosen.items()}
    parameters = tuple(values[name] for name in model.parameter_names)
    return replace(problem, model=model, parameters=parameters, inputs=tuple(names), meanings=meanings)


def forces_of(problem: InitialValueProblem) -> Mapping[str, Force]:
    """Forces on the sites by name: f_3 acts on y_3; none of a model that is of first order by declaration."""
    model: Any = problem.model
    states = model.state_names
    if model.declaration is not None:
        count, masses = model.declaration.size, ca.vertsplit(model.equations.masses)
        factors: Sequence[Expression | float] = [1.0 / mass for mass in masses]
    elif model.order == 2 or problem.chain:
        count = len(states) // 2
        factors = [1.0] * count
    else:
        return {}
    return {
        f"f_{name.removeprefix('y_')}": Force(count + i, factor, f"force on {name}")
        for i, (name, factor) in enumerate(zip(states[:count], factors, strict=True))
    }


def _forced(model: OdeModel, names: Sequence[str], forces: Mapping[str, Force]) -> OdeModel:
    """The model of first order with its parameters in this order, forces among them."""
    kind, first = type(model.state), model.first_order()
    x, p = kind.sym("x", model.full_size), kind.sym("p", len(names))
    time = kind.sym("t") if model.time is None else model.time
    places = {name: p[i] for i, name in enumerate(names)}
    own = ca.vertcat(*(places[name] for name in model.parameter_names)) if model.parameter_names else kind(0, 1)
    outputs = list(model.outputs.values())
    results = [ca.densify(first.full_rhs), *outputs, *(kind(force.factor) for force in forces.values())]
    found = first.function("unforced", *results).call([time, x, own], True, False)
    rate, factors = found[0], found[1 + len(outputs) :]
    for (name, force), factor in zip(forces.items(), factors, strict=True):
        rate[force.row] += factor * places[name]
    period = model.forcing_period
    if isinstance(period, ca.SX | ca.MX):  # in the new parameters
        period = ca.Function("T", [model.parameters], [period]).call([own], True, False)[0]
    return OdeModel(
        model.name, x, rate, p, time=model.time, forcing_period=period, state_labels=model.state_names,
        outputs=dict(zip(model.outputs, found[1 : 1 + len(outputs)], strict=True)), parameter_labels=tuple(names),
        checked=False,
    )  # fmt: skip
