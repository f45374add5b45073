"""Guesses of solutions from numbers, functions, arrays, simulations and other solutions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from numbers import Real
from typing import Any, Protocol, TypeAlias, TypeGuard, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from casadi_skin.model.arguments import check_name, cut, number, short_repr
from casadi_skin.model.expressions import real_array
from casadi_skin.zero.problem import Array
from casadi_skin.zero.statement import Statement

T = TypeVar("T")


@runtime_checkable
class Evaluated(Protocol):
    """A solution, an orbit or a simulation."""

    def evaluate(self, t: ArrayLike) -> Array:
        """States, shape (time, component)."""
        ...


Guess: TypeAlias = Evaluated | Mapping[str, Any] | Callable[[float], Any] | ArrayLike | tuple[ArrayLike, ArrayLike]
JUMP_SAMPLES = 4001  # of a guess that has jumps
FIRST_SAMPLES = 501  # of any guess
SMOOTH_RANGES = 50.0  # ranges that a state without jumps goes through in an interval, at its greatest speed
CLOSED_GUESS_RTOL = 1e-6  # relative to the ranges of the states: a function that closes to this is left alone
CLOSER_RATIO = 0.1  # of how far it is from closing after the stated period, after its own
NEAR_PERIOD_RATIO = 0.25  # of the stated period, where its own is sought
CLOSING_STEP = 1e-9  # last step, relative to the period
ACCEPTED_GUESSES = (
    "numbers, one a state; a function of t; numbers or functions by state name; (t, x) with x of shape (times, "
    "states) or (states, times); a simulation or a solution"
)


def sampled(statement: Statement, guess: Guess, t: Array) -> Array:
    """The guess at times t, shape (time, component); raises ValueError unless it is one."""
    n = statement.model.full_size
    values = _values(statement.model.state_names, guess, t)
    if values.shape != (t.size, n):
        one = values.ndim == 2 and len(values) == t.size
        given = f"{values.shape[1]} at a time" if one else f"shape {values.shape} at {t.size} times"
        raise ValueError(f"guess: given {given}; accepted: {n} states: {', '.join(statement.model.state_names)}")
    if not np.all(np.isfinite(values)):
        raise ValueError("guess: given values that are not finite; accepted: finite numbers")
    return values


def known_times(statement: Statement, guess: Guess, count: int) -> Array:
    """Times over the interval at which a guess is best sampled: those of a simulated cycle, or even ones."""
    start, end = statement.span()
    known = getattr(guess, "times", None)
    return np.linspace(start, end, count) if known is None else start + (end - start) * known / known[-1]


def over_its_own_period(guess: Guess, names: Sequence[str], period: float, rotation: Array) -> Guess:
    """A function of time that closes after another time near the period, stretched to it; any other guess as it is.

    Where it does not close, a wave that goes around a ring has its jump at another phase of every unit, and what that
    does to the phases dies out slowly, so that Newton's method and Ipopt lose their way. `rotation` is what a period
    adds to the states called `names`.
    """
    functions = guess.values() if isinstance(guess, Mapping) else () if isinstance(guess, Evaluated) else (guess,)
    if not any(map(callable, functions)):
        return guess

    def at(t: float) -> Array:
        return np.asarray(_values(names, guess, np.array([t]))[0], dtype=float)

    try:
        ratio = _closing_time(at, period, rotation) / period
    except Exception:  # of the user's function, beyond the period for one: reported where it is sampled
        return guess
    return guess if ratio == 1.0 else lambda t: at(ratio * t)


def _closing_time(at: Callable[[float], Array], period: float, rotation: Array) -> float:
    """The time near the period after which a function closes, by nonlinear least squares; the period else."""
    from scipy.optimize import least_squares

    ranges, first = np.ptp([at(period * k / 8.0) for k in range(9)], axis=0), at(0.0)
    sizes = np.where(ranges > 0.0, ranges, 1.0)

    def miss(ratio: Array) -> Array:
        return np.asarray((at(period * float(ratio[0])) - first - rotation) / sizes)

    before = float(np.linalg.norm(miss(np.ones(1))))
    if before <= CLOSED_GUESS_RTOL:
        return period
    limits = 1.0 - NEAR_PERIOD_RATIO, 1.0 + NEAR_PERIOD_RATIO
    found = least_squares(miss, np.ones(1), bounds=limits, diff_step=[1e-6], xtol=CLOSING_STEP, ftol=None, gtol=None)
    return period * float(found.x[0]) if np.linalg.norm(found.fun) <= CLOSER_RATIO * before else period


def along_the_guess(statement: Statement, guess: Guess, counts: Sequence[int]) -> list[Array]:
    """Lengths of intervals that hold equal parts of time and of the length of a guess with jumps; empty for others.

    One array of shape (intervals,) for each of `counts`. The states are measured by their ranges. A guess with
    its own times, as a simulated cycle, is sampled there.
    """
    if is_straight(guess):
        return []
    start, end = statement.span()
    for samples in (FIRST_SAMPLES, JUMP_SAMPLES):
        times = known_times(statement, guess, samples)
        fine = np.unique(np.concatenate([times, 0.5 * (times[1:] + times[:-1])]))
        values = sampled(statement, guess, fine)
        ranges = np.ptp(values, axis=0)
        steps = np.abs(np.diff(values, axis=0)) / np.where(ranges > 0.0, ranges, np.inf)
        if np.all(
            np.max(steps, axis=1) * (end - start) < SMOOTH_RANGES * np.diff(fine)
        ):  # samples may be dense in a jump
            return []
    length = np.diff(fine) / (end - start) + np.sum(steps, axis=1) + 4.0 / (fine.size - 1)
    total = np.concatenate([[0.0], np.cumsum(length)])
    places = (fine - start) / (end - start)
    return [np.diff(np.interp(np.linspace(0.0, total[-1], count + 1), total, places)) for count in counts]


def is_straight(guess: Guess) -> bool:
    """Whether a guess is numbers, one a state, or samples at two times: such a guess says nothing of a mesh."""
    constant = isinstance(guess, list | tuple | np.ndarray) and all(isinstance(entry, Real) for entry in guess)
    return constant or (_is_sampled(guess) and np.size(guess[0]) == 2)


def _is_sampled(guess: Guess) -> TypeGuard[tuple[ArrayLike, ArrayLike]]:
    """Whether a guess is (t, x)."""
    times = guess[0] if isinstance(guess, list | tuple) and len(guess) == 2 else None
    return isinstance(times, list | tuple | range | np.ndarray)


def _values(names: Sequence[str], guess: Any, t: Array) -> Array:
    if not isinstance(guess, list | tuple | np.ndarray) and isinstance(guess, Evaluated):
        evaluated = partial(guess.evaluate, t)
        return np.asarray(_called(evaluated, f"{short_repr(guess)} fails", ACCEPTED_GUESSES), dtype=float)
    if isinstance(guess, Mapping):
        for name in guess:
            check_name("guess", name, names)
        return np.stack([_column(name, guess.get(name, 0.0), t) for name in names], axis=1)
    if callable(guess):

        def rows() -> Array:
            return np.array([np.asarray(guess(float(x)), dtype=float).ravel() for x in t])

        return _called(rows, "the function fails", f"one that gives {len(names)} numbers")
    if _is_sampled(guess):
        times, values = (real_array("guess", part, ACCEPTED_GUESSES) for part in guess)
        turned = values.shape == (len(names), times.size) != (times.size, len(names))  # as scipy has it
        return _interpolated(times, values.T if turned else values, t)
    return np.tile(real_array("guess", guess, ACCEPTED_GUESSES).ravel(), (t.size, 1))


def _column(name: str, given: Any, t: Array) -> Array:
    """Values of one state from a number or a function."""
    accepted = "a number, or a function of t"
    if callable(given):
        column = partial(np.fromiter, (float(given(float(x))) for x in t), float)
        return _called(column, f"the function for {name} fails", accepted)
    try:
        return np.full(t.size, number(name, given))
    except (TypeError, ValueError):
        raise ValueError(f"guess: given {short_repr(given)} for {name}; accepted: {accepted}") from None


def _called(compute: Callable[[], T], words: str, accepted: str) -> T:
    """The result of a function of the user, of a class, or of somebody else's object; raises ValueError as it fails."""
    try:
        return compute()
    except Exception as error:
        raised = cut(" ".join(f"{type(error).__name__}: {error}".split()), 200)
        raise ValueError(f"guess: {words}: {raised}; accepted: {accepted}") from error


def _interpolated(times: Array, values: Array, t: Array) -> Array:
    if times.ndim != 1 or times.size != len(values) or times.size < 2 or not np.all(np.diff(times) > 0):
        given = f"times of shape {times.shape}, states of shape {values.shape}"
        raise ValueError(f"guess: given {given}; accepted: two or more ascending times, one row of states each")
    if not np.all(np.isfinite(values)):
        raise ValueError("guess: given values that are not finite; accepted: finite numbers")
    if times.size == 2:
        share = np.clip((t - times[0]) / (times[1] - times[0]), 0.0, 1.0)[:, None]
        return np.asarray((1.0 - share) * values[0] + share * values[1])
    from scipy.interpolate import CubicSpline

    return np.asarray(CubicSpline(times, values)(np.clip(t, times[0], times[-1])))
