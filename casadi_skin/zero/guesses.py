"""Guesses of solutions from numbers, functions, arrays, simulations and other solutions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from numbers import Real
from typing import Any, Protocol, TypeAlias, TypeGuard, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from casadi_skin.model.arguments import check_name, cut, number, short_repr
from casadi_skin.model.expressions import real_array
from casadi_skin.zero.problem import Array
from casadi_skin.zero.statement import Statement


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
CLOSING_STEP, CLOSING_STEPS = 1e-9, 12  # last step, relative to the period, and the number of steps
ACCEPTED_GUESSES = (
    "numbers, one a state; a function of t; numbers or functions by state name; (t, x) with x of shape (times, "
    "states) or (states, times); a simulation or a solution"
)


def sampled(statement: Statement, guess: Guess, t: Array) -> Array:
    """The guess at times t, shape (time, component); raises ValueError unless it is one."""
    n = statement.model.full_size
    values = _values(statement, guess, t)
    if values.shape != (t.size, n):
        one = values.ndim == 2 and len(values) == t.size
        given = f"{values.shape[1]} at a time" if one else f"shape {values.shape} at {t.size} times"
        raise ValueError(f"guess: given {given}; accepted: {n} states: {', '.join(statement.model.state_names)}")
    if not np.all(np.isfinite(values)):
        raise ValueError("guess: given values that are not finite; accepted: finite numbers")
    return values


def known_times(statement: Statement, guess: Guess, count: int) -> Array:
    """Times over the interval at which a guess is best sampled: those of a simulated cycle, or even ones."""
    start, end = statement.span(np.array(list(statement.values.values())))
    known = getattr(guess, "times", None)
    return np.linspace(start, end, count) if known is None else start + (end - start) * known / known[-1]


def over_its_own_period(guess: Guess, names: Sequence[str], period: float, rotation: Array) -> Guess:
    """A function of time that closes after another time near the period, stretched to it; any other guess as it is.

    Where it does not close, a wave that goes around a ring has its jump at another phase of every unit, and what that
    does to the phases dies out slowly, so that Newton's method and Ipopt lose their way. `rotation` is what a period
    adds to the states called `names`.
    """
    at = _function(guess, names)
    if at is None:
        return guess
    try:
        ratio = _closing_time(at, period, rotation) / period
    except Exception:  # of the user's function, beyond the period for one: reported where it is sampled
        return guess
    if ratio == 1.0:
        return guess
    direct = guess if callable(guess) else at
    return lambda t: direct(ratio * t)


def _function(guess: Guess, names: Sequence[str]) -> Callable[[float], Array] | None:
    """The guess as a function of time; None where it is none."""
    if isinstance(guess, Mapping):
        parts = [guess.get(name, 0.0) for name in names]
        if set(guess) <= set(names) and any(callable(part) for part in parts):
            return lambda t: np.array([float(part(t) if callable(part) else part) for part in parts])
        return None
    if not callable(guess) or isinstance(guess, Evaluated):
        return None
    function = guess
    return lambda t: np.asarray(function(t), dtype=float).ravel()


def _closing_time(at: Callable[[float], Array], period: float, rotation: Array) -> float:
    """The time near the period after which a function closes, by the method of Gauss and Newton; the period else."""
    ranges = np.ptp([at(period * k / 8.0) for k in range(9)], axis=0)
    sizes = np.where(ranges > 0.0, ranges, 1.0)

    def scaled(t: float) -> Array:
        return np.asarray((at(t) - first - rotation) / sizes)

    first, own = at(0.0), period
    miss = scaled(own)
    before, h = float(np.linalg.norm(miss)), 1e-4 * period
    if before <= CLOSED_GUESS_RTOL:
        return period
    for _ in range(CLOSING_STEPS):
        slope = (scaled(own + h) - scaled(own - h)) / (2.0 * h)
        step = float(slope @ miss) / float(slope @ slope)
        own -= step
        if not abs(own - period) <= NEAR_PERIOD_RATIO * period:
            return period
        miss = scaled(own)
        if abs(step) <= CLOSING_STEP * period:
            break
    return own if np.linalg.norm(miss) <= CLOSER_RATIO * before else period


def along_the_guess(statement: Statement, guess: Guess, counts: Sequence[int]) -> list[Array]:
    """Lengths of intervals that hold equal parts of time and of the length of a guess with jumps; empty for others.

    One array of shape (intervals,) for each of `counts`. The states are measured by their ranges. A guess with
    its own times, as a simulated cycle, is sampled there.
    """
    if is_straight(guess):
        return []
    start, end = statement.span(np.array(list(statement.values.values())))
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
    return _is_constant(guess) or (_is_sampled(guess) and np.size(guess[0]) == 2)


def _is_constant(guess: Guess) -> bool:
    if not isinstance(guess, list | tuple | np.ndarray):
        return False
    return all(isinstance(entry, Real) for entry in guess)


def _is_sampled(guess: Guess) -> TypeGuard[tuple[ArrayLike, ArrayLike]]:
    """Whether a guess is (t, x)."""
    if not isinstance(guess, list | tuple) or len(guess) != 2:
        return False
    return isinstance(guess[0], list | tuple | range | np.ndarray)


def _values(statement: Statement, guess: Guess, t: Array) -> Array:
    names = statement.model.state_names
    if not isinstance(guess, list | tuple | np.ndarray) and isinstance(guess, Evaluated):
        return _evaluated(guess, t)
    if isinstance(guess, Mapping):
        for name in guess:
            check_name("guess", name, names)
        return np.stack([_column(name, guess.get(name, 0.0), t) for name in names], axis=1)
    if callable(guess):
        try:
            return np.array([np.asarray(guess(float(x)), dtype=float).ravel() for x in t])
        except Exception as error:  # of the user's function
            accepted = f"one that gives {len(names)} numbers"
            raise ValueError(f"guess: the function fails: {_words(error)}; accepted: {accepted}") from error
    if _is_sampled(guess):
        times, values = (real_array("guess", part, ACCEPTED_GUESSES) for part in guess)
        turned = values.shape == (len(names), times.size) != (times.size, len(names))  # as scipy has it
        return _interpolated(times, values.T if turned else values, t)
    return np.tile(real_array("guess", guess, ACCEPTED_GUESSES).ravel(), (t.size, 1))


def _evaluated(guess: Evaluated, t: Array) -> Array:
    try:
        return np.asarray(guess.evaluate(t), dtype=float)
    except Exception as error:  # of a class, or of somebody else's object
        raise ValueError(f"guess: {short_repr(guess)} fails: {_words(error)}; accepted: {ACCEPTED_GUESSES}") from error


def _column(name: str, given: Any, t: Array) -> Array:
    """Values of one state from a number or a function."""
    accepted = "a number, or a function of t"
    if not callable(given):
        try:
            return np.full(t.size, number(name, given))
        except (TypeError, ValueError):
            raise ValueError(f"guess: given {short_repr(given)} for {name}; accepted: {accepted}") from None
    try:
        return np.array([float(given(float(x))) for x in t])
    except Exception as error:  # of the user's function, and of values that are no numbers
        raise ValueError(f"guess: the function for {name} fails: {_words(error)}; accepted: {accepted}") from error


def _words(error: Exception) -> str:
    """What a function of the user raised, in a line."""
    return cut(" ".join(f"{type(error).__name__}: {error}".split()), 200)


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
