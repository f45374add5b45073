"""Periodic orbits of any model as boundary-value problems: autonomous, forced, conservative, reversible.

An orbit of an autonomous model has an unknown period and a phase that an integral condition fixes (Doedel 1981): the
orbit is orthogonal to the derivative of a reference, here a trigonometric polynomial made from the guess. In a
conservative model orbits come in families at fixed parameters, so that a condition selects one, and the equations are
made regular by a multiple of a damping that comes back as zero (Sepulchre and MacKay 1997; Munoz-Almaraz et al. 2003).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import casadi as ca
import numpy as np

from casadi_skin.arguments import by_name, number, short_repr, truth, whole
from casadi_skin.bvp.stated_problem import PERIOD
from casadi_skin.bvp.statement import Bounds, Statement, check_expression
from casadi_skin.bvp.symmetry import SymmetryClass, pinned_components, symmetry_class
from casadi_skin.models.expressions import Expression, expression_of
from casadi_skin.models.ode import OdeModel
from casadi_skin.orbits.boundary_space import BoundarySpace, Periodic
from casadi_skin.orbits.guesses import Guess, known_times, sampled
from casadi_skin.orbits.orbit import Orbit
from casadi_skin.orbits.rank_deficiency import equilibrium_words
from casadi_skin.orbits.refined import BoundaryError
from casadi_skin.orbits.solution import Solution
from casadi_skin.orbits.solve import solve

UNFOLDING = "unfolding"
SAMPLES = 256  # of the guess over a period
NOT_ZERO = 100.0  # tolerances that the unfolding parameter may differ from zero by
LARGEST = 1e150  # state of a guess
HARMONICS = 12  # of the reference of the phase
SHRUNK, STILL = 1e-6, 1e-12  # motion relative to that of the guess, and to the states, that is none


def find_orbit(
    model: OdeModel,
    guess: Guess,
    period: float | None = None,
    *,
    parameters: Mapping[str, float] | None = None,
    select: Expression | None = None,
    section: Expression | None = None,
    symmetric: bool = False,
    cycles: int = 1,
    free: Sequence[str] = (),
    bounds: Bounds | None = None,
    objective: Expression | str | None = None,
    running: Expression | None = None,
    **options: Any,
) -> Orbit:
    """The periodic orbit near a guess.

    `guess` gives the states over one period from time 0 on, as in `BoundaryValueProblem.solve`; `period` guesses the
    period of an autonomous model, where the guess (a cycle, another orbit) has none; the orbit of a forced one closes
    after `cycles` periods of the forcing. `select`, an expression in states and parameters that vanishes at phase zero,
    picks a member of the family in a model with a `hamiltonian` or where the orbit is `symmetric`: reversible, and then
    only half of it is unknown, or a quarter with the half-period symmetry. `section` vanishes at phase zero in place of
    the integral phase condition; without it phase zero is where the guess has it, so that a guess shifted in time makes
    `select` pick another member of a family, unless what it holds is conserved.

    Parameters that are `free` are found with the orbit: by `select`, or so that `objective` (at phase zero, or the word
    "period") plus the mean of `running` over the period is smallest within `bounds` on states, free parameters and
    "period". Expressions may be given as functions f(t, x, p) of CasADi's symbols. Options are those of
    `BoundaryValueProblem.solve`. Raises ValueError and TypeError for arguments that do not fit the model, BoundaryError
    where no orbit is found.
    """
    if not isinstance(model, OdeModel):
        raise TypeError(f"model: given {short_repr(model)}; accepted: an OdeModel")
    _check(model, period, select, section, truth("symmetric", symmetric), cycles, free)
    first = model.first_order()
    stated = {"select": select, "section": section, "objective": objective, "running": running}
    select, section, objective, running = (scalar_of(label, given, first) for label, given in stated.items())
    length = 0.0 if model.forced else guessed_period(guess, period)
    search = (tuple(free), by_name("bounds", bounds, "(lower, upper)"), objective, running)
    asked = _Asked(first, length, cycles, by_name("parameters", parameters), select, section, *search)
    symmetry = symmetry_class(model) if symmetric else SymmetryClass.FULL
    state_problem = _forced_problem if model.forced else _symmetric_problem if symmetric else _closed_problem
    solution = solve(state_problem(asked, guess, symmetry), guess, **options)
    space = replace(cast(BoundarySpace, solution.space), periodic=Periodic(model, first, symmetry))
    orbit = Orbit(space, solution.point, solution.exact, solution.optimum)
    if not model.forced:
        _check_moves(orbit, solution, guess, length)
    if abs(orbit.unfolding) > NOT_ZERO * max(space.tolerance, orbit.error):
        words = f"the unfolding parameter is {orbit.unfolding:.1e} in place of 0"
        raise BoundaryError(f"{model.name}: {words}: the hamiltonian is not conserved, or the orbit is degenerate")
    return orbit


def closed_statement(model: OdeModel, guess: Guess, period: float, parameters: Mapping[str, float]) -> Statement:
    """The closed orbit of an autonomous model of first order, with an unknown period and the phase of a guess."""
    asked = _Asked(model, period, 1, dict(parameters), None, None, (), {}, None, None)
    return _closed_problem(asked, guess, SymmetryClass.FULL)


def forced_statement(model: OdeModel, cycles: int, parameters: Mapping[str, float]) -> Statement:
    """The orbit of a forced model of first order that closes after a number of periods of the forcing."""
    asked = _Asked(model, 0.0, cycles, dict(parameters), None, None, (), {}, None, None)
    return _forced_problem(asked, np.zeros(model.full_size), SymmetryClass.FULL)


def scalar_of(label: str, given: Any, model: OdeModel) -> Any:
    """A scalar expression of what a script gave for it, a function f(t, x, p) too; names and None as they are."""
    if given is None or isinstance(given, str):
        return given
    time = type(model.state).sym("t") if model.time is None else model.time
    symbols = [time, model.full_state, model.parameters]
    expression = expression_of(label, given, symbols, constants=False)
    if expression.numel() != 1:
        raise ValueError(f"{label}: given shape {expression.shape}; accepted: a scalar expression")
    return expression


def _check_moves(orbit: Orbit, solution: Solution, guess: Guess, length: float) -> None:
    """Raises BoundaryError for what does not move: an equilibrium solves the equations of an orbit of any period."""
    statement, states = solution.statement, solution.states
    wanted = np.ptp(sampled(statement, guess, np.linspace(0.0, length, SAMPLES)), axis=0)
    moved, size = np.ptp(states, axis=0), np.max(np.abs(states), axis=0)
    if np.any(moved > np.maximum(SHRUNK * wanted, STILL * size)):
        return
    raise BoundaryError(f"{orbit.model.name}: {equilibrium_words(solution.problem, solution.point.z)}")


def guessed_period(guess: Guess, period: float | None) -> float:
    """The period that is given, or that the guess has; raises ValueError and TypeError where neither is."""
    found = number("period", getattr(guess, "period", None) if period is None else period, "a number > 0")
    if found <= 0:
        raise ValueError(f"period: given {period!r}; accepted: a number > 0")
    return found


def _check(
    model: OdeModel,
    period: float | None,
    select: Expression | None,
    section: Expression | None,
    symmetric: bool,
    cycles: int,
    free: Sequence[str],
) -> None:
    whole("cycles", cycles, 1)
    if not isinstance(free, list | tuple):
        raise TypeError(f"free: given {short_repr(free)}; accepted: a list of names of parameters")
    if model.forced:
        given = [n for n, v in (("period", period), ("section", section)) if v is not None]
        given += ["symmetric"] if symmetric else []
        if given:
            raise ValueError(f"{given[0]}: given for {model.name}, which is forced; accepted: cycles alone")
        return
    if cycles != 1:
        raise ValueError(f"cycles: given {cycles} for {model.name}, which is autonomous; accepted: 1, with its period")
    if symmetric and model.reversal is None:
        raise ValueError(f"symmetric: given for {model.name}, which declares no reversal; accepted: with one")
    family = symmetric or model.hamiltonian is not None
    if family and select is None and not free:
        why = "symmetric" if symmetric else "conservative"
        raise ValueError(f"select: given none; accepted: an expression, for {why} orbits come in families")
    if not family and select is not None and not free:
        raise ValueError(f"select: given for {model.name}; accepted: with a hamiltonian, symmetric = True or free")
    if symmetric and section is not None:
        raise ValueError("section: given with symmetric = True, which fixes the phase; accepted: one of them")
    for name in (PERIOD, UNFOLDING):
        if name in model.parameter_names or name in model.state_names:
            raise ValueError(f"{model.name}: given a state or parameter called {name}; accepted: other names")


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class _Extended(OdeModel):
    """A model with more parameters; its values are as good as those of the one that it is made of."""

    inner: OdeModel

    @property
    def rounding(self) -> float:
        return self.inner.rounding


@dataclass(frozen=True, eq=False)
class _Asked:
    """A first-order model, a guessed period, parameters, and what is asked of the orbit."""

    model: OdeModel
    length: float
    cycles: int
    values: Mapping[str, float]
    select: Expression | None
    section: Expression | None
    free: tuple[str, ...]
    bounds: Bounds
    objective: Expression | str | None
    running: Expression | None

    def extended(self, unfolded: bool) -> OdeModel:
        """The model with its period, and the coefficient of a damping, among the parameters; time goes from 0 to it."""
        model, kind = self.model, type(self.model.state)
        names = (*model.parameter_names, PERIOD, *([UNFOLDING] if unfolded else []))
        p, count = kind.sym("p", len(names)), int(model.parameters.numel())
        rhs = model.field_at(0.0, model.state, p[:count])
        if unfolded:
            slope = model.function("slope", ca.gradient(model.hamiltonian, model.state))
            rhs = rhs + p[count + 1] * slope(0.0, model.state, p[:count])
        nominal = [*(model.nominal or ()), self.length, *([0.0] if unfolded else [])]
        return _Extended(
            model.name, model.state, rhs, p, time=kind.sym("t"), forcing_period=p[count], checked=False,
            nominal=tuple(nominal) if len(nominal) == len(names) else None,
            state_labels=model.state_names, parameter_labels=names, inner=model,
        )  # fmt: skip

    def at_start(self, model: OdeModel, label: str, expression: Expression) -> Expression:
        """An expression in states and parameters of the model, at phase zero of the extended one."""
        check_expression(label, expression, [self.model.state, self.model.parameters])
        count = int(self.model.parameters.numel())
        function = ca.Function("condition", [self.model.state, self.model.parameters], [expression])
        return function(model.ends[0], model.parameters[:count])

    def parameters(self, model: OdeModel) -> dict[str, float]:
        """Values of the parameters, the unfolding's among them, by name."""
        added = {PERIOD: self.length, UNFOLDING: 0.0}
        nominal = dict(zip(self.model.parameter_names, self.model.nominal or (), strict=False))
        known = nominal | added
        return {name: known[name] for name in model.parameter_names if name in known} | dict(self.values)

    def minimised(self, model: OdeModel, period: Expression) -> dict[str, Any]:
        """Objective and running cost of the statement, in the extended model."""
        found: dict[str, Any] = {"bounds": self.bounds}
        if isinstance(self.objective, str):
            if self.objective != PERIOD:
                raise ValueError(
                    f"objective: given {short_repr(self.objective)}; accepted: an expression, or {PERIOD!r}"
                )
            found["objective"] = type(model.state)(period)
        elif self.objective is not None:
            found["objective"] = self.at_start(model, "objective", self.objective)
        if self.running is not None:
            symbols = [self.model.state, self.model.parameters, *([self.model.time] if self.model.forced else [])]
            check_expression("running", self.running, symbols)
            along = self.model.function("running", self.running)
            time = model.time if self.model.forced else 0.0
            count = int(self.model.parameters.numel())
            found["running"] = along(time, model.state, model.parameters[:count]) / period
        return found


def _forced_problem(asked: _Asked, guess: Guess, symmetry: SymmetryClass) -> Statement:
    """Whole periods of the forcing, closed."""
    model = asked.model
    assert model.forcing_period is not None
    period = asked.cycles * model.forcing_period
    conditions = [model.end(model.state) - model.start(model.state)]
    conditions += [] if asked.select is None else [asked.at_start(model, "select", asked.select)]
    return Statement(
        model, conditions, (), (0.0, period), asked.values, asked.free, **asked.minimised(model, period)
    )  # fmt: skip


def _closed_problem(asked: _Asked, guess: Guess, symmetry: SymmetryClass) -> Statement:
    """The whole period, closed, with a phase; unfolded where the model is conservative."""
    unfolded = asked.model.hamiltonian is not None
    model = asked.extended(unfolded)
    period = model.parameters[model.parameter_names.index(PERIOD)]
    conditions = [model.end(model.state) - model.start(model.state)]
    if asked.select is not None:
        conditions.append(asked.at_start(model, "select", asked.select))
    integrals = []
    if asked.section is not None:
        conditions.append(asked.at_start(model, "section", asked.section))
    else:
        integrals.append(_phase(model, model.time / period, asked, guess) / period)
    free = [PERIOD, *([UNFOLDING] if unfolded else []), *asked.free]
    return Statement(
        model, conditions, integrals, (0.0, period), asked.parameters(model), free, **asked.minimised(model, period)
    )  # fmt: skip


def _symmetric_problem(asked: _Asked, guess: Guess, symmetry: SymmetryClass) -> Statement:
    """Half or a quarter of the period, from one fixed set of the reversal to the other."""
    first, last = pinned_components(asked.model, symmetry)
    model = asked.extended(False)
    period = model.parameters[model.parameter_names.index(PERIOD)]
    conditions = [model.start(model.state)[first], model.end(model.state)[last]]
    conditions += [] if asked.select is None else [asked.at_start(model, "select", asked.select)]
    minimised, part = asked.minimised(model, period), symmetry.value
    if "running" in minimised:
        minimised["running"] = minimised["running"] / part
    return Statement(
        model, conditions, (), (0.0, part * period), asked.parameters(model), [PERIOD, *asked.free], **minimised
    )  # fmt: skip


def _phase(model: OdeModel, turn: Expression, asked: _Asked, guess: Guess) -> Expression:
    """The orbit times the derivative of its reference, scaled so that a shift of phase changes the mean by itself."""
    statement = Statement(
        model, [model.start(model.state)], interval=(0.0, asked.length), parameters=asked.parameters(model)
    )
    times = known_times(statement, guess, SAMPLES + 1)
    values = sampled(statement, guess, times)
    largest = float(np.max(np.abs(values)))
    if largest > LARGEST:
        raise ValueError(
            f"guess: given states up to {largest:.3g}; accepted: up to {LARGEST:g}, whose squares are finite"
        )
    order = np.arange(1, HARMONICS + 1)
    waves = np.exp(-2j * np.pi * np.outer(order, times / asked.length))
    c = 2.0 / asked.length * np.trapezoid(waves[:, :, None] * values, times, axis=1)
    size = float(np.sum(order[:, None] ** 2 * np.abs(c) ** 2)) / 2.0
    if not size > 1e-24 * largest**2:
        raise ValueError("guess: given a state that does not move; accepted: one period of an orbit")
    angle = 2.0 * np.pi * turn * ca.DM(order)
    slope = -ca.sin(angle).T @ ca.DM(order[:, None] * c.real) - ca.cos(angle).T @ ca.DM(order[:, None] * c.imag)
    return ca.mtimes(slope, model.state) / size
