"""Finding equilibria: near a guess, where a simulation settles, from several starts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Protocol, cast, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from casadi_skin.follow.equilibrium import Equilibrium
from casadi_skin.follow.rest_space import EquilibriumError, EquilibriumSpace
from casadi_skin.model import methods
from casadi_skin.model.arguments import by_name, check_name, number, short_repr, state_by_name, whole
from casadi_skin.model.jumps import JumpError
from casadi_skin.model.ode import OdeModel
from casadi_skin.solve.corrector import Correction
from casadi_skin.solve.threads import one_thread
from casadi_skin.zero.equations import corrector_of
from casadi_skin.zero.problem import Array
from casadi_skin.zero.rest_problem import sizes_at, sizes_of
from casadi_skin.zero.statics import Statics

TOLERANCES = (1e-13, 1e-2)
MOST_STARTS = 1_000_000
SETTLED = 0.05  # of the sizes of the state: where a simulation ends, from the equilibrium that it is said to settle at
FAR = 4.0  # powers of two between the sizes of a guess and those of the equilibrium found
SAME = 1e-6  # of the sizes: distance of two equilibria that are the same
ACCEPTED = "numbers, one a state, numbers by state name, a simulation or another equilibrium"


@runtime_checkable
class Tunable(Protocol):
    """A model that hands in an `OdeModel` with all its parameters, as `Chain` does."""

    def tunable_model(self) -> OdeModel:
        """The model with its parameters as symbols."""
        ...


def find_equilibrium(
    model: OdeModel | Tunable,
    guess: Any,
    *,
    parameters: Mapping[str, float] | None = None,
    transient: float | None = None,
    tolerance: float = 1e-10,
    corrector: str = "newton",
) -> Equilibrium:
    """The equilibrium near a guess, or where a simulation settles; dimensionless, or in the model's units.

    Arguments:
        model: an `OdeModel` of first or second order that no force drives in time, or a `Chain`.
        guess: numbers, one a state (of a model of second order the positions, or positions and velocities); numbers by
            state name, others 0; a simulation, whose end is taken; another equilibrium.
        parameters: values by name, where they are not the model's nominal ones.
        transient: time to simulate from the guess first.
        tolerance: relative error of each component, which counts as no less than a thousandth of its guess.
        corrector: "newton", which tries Ipopt where it fails, or "ipopt".

    Returns:
        The equilibrium, with its eigenvalues and its estimated error.

    Raises:
        ValueError, TypeError: an argument does not fit the model; a forced model is refused.
        EquilibriumError: no equilibrium is found, it is not alone, or the simulation does not settle.
        IntegrationError: the simulation fails.
    """
    statics = _statics(model, parameters)
    model = statics.model
    _check(tolerance, corrector)
    start = positions_of(model, guess)
    with one_thread(), np.errstate(all="ignore"):  # of equations that are not finite somewhere
        if transient is None:
            return _near(EquilibriumSpace(statics, float(tolerance), corrector, sizes_of([start])), start)
        return _settled(statics, start, number("transient", transient), float(tolerance), corrector)


def find_equilibria(
    model: OdeModel | Tunable,
    lower: ArrayLike,
    upper: ArrayLike,
    *,
    starts: int = 64,
    seed: int = 0,
    parameters: Mapping[str, float] | None = None,
    tolerance: float = 1e-10,
    corrector: str = "newton",
) -> tuple[Equilibrium, ...]:
    """The distinct equilibria near several starts in a box; there may be more.

    Arguments:
        model: as in `find_equilibrium`.
        lower, upper: corners of the box, one number a state or by state name; equilibria may lie outside.
        starts: number of starts, spread by a Sobol sequence.
        seed: of its scrambling.
        parameters, tolerance, corrector: as in `find_equilibrium`.

    Returns:
        The equilibria in the order of their first component; empty without any.

    Raises:
        ValueError, TypeError: an argument does not fit the model.
    """
    from scipy.stats.qmc import Sobol

    statics = _statics(model, parameters)
    model = statics.model
    _check(tolerance, corrector)
    low, high = positions_of(model, lower, "lower"), positions_of(model, upper, "upper")
    if not np.all(low <= high):
        raise ValueError("upper: given a number below that in lower; accepted: numbers >= those in lower")
    whole("starts", starts, 1, MOST_STARTS)
    whole("seed", seed, 0)
    space = EquilibriumSpace(statics, float(tolerance), corrector, sizes_of([low, high]))
    places = Sobol(statics.size, seed=seed).random(1 << max(0, (starts - 1).bit_length()))[:starts]
    found: list[Equilibrium] = []
    with one_thread():
        for place in places:
            try:
                equilibrium = _near(space, low + place * (high - low), second=False)
            except ArithmeticError:
                continue
            apart = [np.max(np.abs(other.positions - equilibrium.positions) / space.sizes) for other in found]
            if min(apart, default=np.inf) > SAME:
                found.append(equilibrium)
    return tuple(sorted(found, key=lambda equilibrium: tuple(equilibrium.positions)))


def _statics(model: Any, parameters: Mapping[str, float] | None) -> Statics:
    """The equations of a model at rest; raises ValueError and TypeError for objects that are no model."""
    model = model.tunable_model() if isinstance(model, Tunable) and not isinstance(model, type) else model
    if not isinstance(model, OdeModel):
        raise TypeError(f"model: given {short_repr(model)}; accepted: an OdeModel or a Chain")
    return Statics(model, dict(by_name("parameters", parameters)))


def _check(tolerance: float, corrector: str) -> None:
    low, high = TOLERANCES
    if not low <= number("tolerance", tolerance) <= high:
        raise ValueError(f"tolerance: given {tolerance!r}; accepted: {low:g} to {high:g}")
    check_name("corrector", corrector, methods.CORRECTORS)


def positions_of(model: OdeModel, guess: Any, label: str = "guess") -> Array:
    """A guess as values of the unknowns, shape (n,); raises ValueError for objects that are no guess."""
    names = model.state_names
    if isinstance(guess, Equilibrium):
        guess = guess.state
    elif hasattr(guess, "states") and hasattr(guess, "t"):  # a simulation, or an orbit
        guess = np.asarray(guess.states)[-1]
    if isinstance(guess, Mapping):
        guess = state_by_name(label, guess, names)
    try:
        values = np.asarray(guess, dtype=float).ravel()
    except (TypeError, ValueError):
        raise ValueError(f"{label}: given {short_repr(guess)}; accepted: {ACCEPTED}") from None
    if values.size not in (model.size, model.full_size):
        shown = ", ".join(names[: model.size])
        raise ValueError(f"{label}: given {values.size}; accepted: {model.size} numbers: {shown}")
    if not np.all(np.isfinite(values)):
        raise ValueError(f"{label}: given numbers that are not finite; accepted: finite numbers")
    return np.array(values[: model.size])


def _near(space: EquilibriumSpace, start: Array, second: bool = True) -> Equilibrium:
    """The equilibrium near a state, by the corrector and, where that fails, by the other one."""
    problem, failures = space.problem, list[str]()
    z, row = np.append(start / space.sizes, 0.0), problem.parameter_row()
    others = [name for name in methods.CORRECTORS if name != space.corrector] if second else []
    for name in (space.corrector, *others):
        correct = space.levels.corrector(problem) if name == space.corrector else None
        correction: Correction = (correct or corrector_of(name, space.tolerance, problem)).correct(z, row, 0.0)
        if correction.converged and np.all(np.isfinite(correction.z)):
            point = space.refined(correction)
            words = space.jump(point)
            if words:
                raise JumpError(space.model.name, f"{words}, at the equilibrium")
            found = Equilibrium(space, point)
            return found if not second else _in_own_units(found)
        worst = problem.worst(correction.z if np.all(np.isfinite(correction.z)) else z)
        failures.append(f"{name}: {correction.status.value}; {worst}")
    full = np.concatenate([start, np.zeros(space.model.full_size - start.size)])
    reach = np.maximum(np.abs(full), np.resize(space.sizes, full.size))
    p = problem.parameters(z)
    words, jumps = _not_finite(space.model, full, p) or failures[0], space.model.jumps.beside(full, p, reach)
    more = f"; beside the guess {jumps}" if jumps else ""
    raise EquilibriumError(f"{space.model.name}: no equilibrium near the guess: {words}{more}")


def _not_finite(model: OdeModel, state: Array, parameters: Array) -> str:
    """The equation that is not finite at a guess; empty where all are."""
    rates = np.array(model.vector_field(0.0, state, parameters)).ravel()
    if np.all(np.isfinite(rates)):
        return ""
    name = model.state_names[int(np.argmax(~np.isfinite(rates)))]
    at = ", ".join(f"{k} = {x:.6g}" for k, x in zip(model.state_names, state, strict=True))
    return f"not finite at the equation of {name}, where {at} at the guess"


def _in_own_units(found: Equilibrium) -> Equilibrium:
    """An equilibrium solved for again where the sizes of its guess are far from its own."""
    space = cast(EquilibriumSpace, found.space)
    sizes = sizes_at(space.statics, found.positions, (), space.sizes)
    if np.max(np.abs(np.log2(sizes / space.sizes))) < FAR:
        return found
    again = replace(space, sizes=sizes)
    z, row = np.append(found.positions / sizes, 0.0), again.problem.parameter_row()
    correction = again.levels.corrector(again.problem).correct(z, row, 0.0)
    return Equilibrium(again, again.refined(correction)) if correction.converged else found


def _settled(statics: Statics, start: Array, transient: float, tolerance: float, corrector: str) -> Equilibrium:
    """The stable equilibrium that a simulation approaches; raises EquilibriumError where it does not settle."""
    from casadi_skin.dynamics.evolve import simulate

    model = statics.model
    if not transient > 0.0:
        raise ValueError(f"transient: given {transient!r}; accepted: a finite number > 0")
    full = np.concatenate([start, np.zeros(model.full_size - model.size)])
    states = simulate(model, full, np.linspace(0.0, transient, 201), parameters=statics.given).states
    end = np.array(states[-1][: model.size])
    space = EquilibriumSpace(statics, tolerance, corrector, sizes_of([end]))
    last = np.stack([state[: model.size] for state in states[-50:]])
    moving = float(np.max(np.ptp(last, axis=0) / np.maximum(np.abs(end), space.sizes)))
    if moving > SETTLED:
        words = f"over its last quarter the state changes by {moving:.2g} of its size"
        raise EquilibriumError(
            f"{model.name}: the simulation does not settle: {words}; try a longer transient or a guess"
        )
    found = _near(space, end)
    apart = float(np.max(np.abs(found.positions - end) / np.maximum(np.abs(end), space.sizes)))
    if apart > SETTLED:
        words = f"the equilibrium found is {apart:.2g} of the state's size from where the simulation ends"
        raise EquilibriumError(f"{model.name}: the simulation does not settle: {words}; try a longer transient")
    return found
