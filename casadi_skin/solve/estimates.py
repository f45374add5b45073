"""Errors of points, from Newton steps on a finer level: estimates, and their part by rounding."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from casadi_skin.zero.problem import EPSILON, Array, Problem, Scalar

SAFETY = 2.0  # the finer step is asymptotically the error itself; twice it covers what the finer grid misses
NEAR_ROUND_OFF = 1e-9  # relative errors below this are compared with those of rounding
FOLD = 1e-4  # tangents that change the parameter by less than this part of its size are those of a fold


@dataclass(frozen=True)
class ErrorEstimate:
    """Estimated errors of a point: absolute in Omega, and of the state relative to its largest component.

    `round_off` is the part, relative like `relative`, below which no discretisation brings them. `parameter` is the
    relative error of the free parameter, 0 where the others are those at its value: only where Omega is held, or in the
    neighbourhood of a fold, where they are those across the branch, is it not.
    """

    Omega: float
    profile: float
    round_off: float = 0.0
    parameter: float = 0.0

    def relative(self, Omega: float) -> float:
        """The largest of the three, with that of Omega made relative."""
        return max(self.Omega / Omega, self.profile, self.parameter)


@dataclass(frozen=True)
class Refinement:
    """An orbit on the next finer level, one Newton step from the orbit prolonged: better by the error estimated."""

    problem: Problem
    z: Array


Measured = tuple[ErrorEstimate, Refinement | None]


def step_error(problem: Problem, z: Array, step: Array, with_parameter: bool = False) -> ErrorEstimate:
    """The error that a step from z to the better point makes up for."""
    parameter = abs(float(step[problem.parameter_index])) / problem.parameter_size(z) if with_parameter else 0.0
    Omega, profile = abs(problem.frequency_step(z, step)), problem.profile_change(z, step)
    return ErrorEstimate(SAFETY * Omega, SAFETY * profile, parameter=SAFETY * parameter)


@dataclass(frozen=True)
class OnFiner:
    """States prolonged to the next level `problem`, (states, size), with a Newton step from each.

    `response` gives the responses to residuals of the size of their rounding, where these are needed.
    """

    problem: Problem
    z: Array
    steps: Array
    response: Callable[[], Array]


def estimated(
    problem: Problem,
    z: Array,
    on_finer: OnFiner,
    tangents: Array | None,
    along: Array | None,
    held: Sequence[Scalar | None],
) -> list[Measured]:
    """The errors of states (states, size) and the better orbits, from the next level.

    `tangents` and `along` are the tangents of the states and there; those of states where something is held are not
    those of their steps.
    """
    finer, long_z = on_finer.problem, on_finer.z
    free, by_Omega = (np.array([which is one for which in held]) for one in (None, Scalar.OMEGA))
    Omega = np.array([problem.frequency(one) for one in z])
    steps = _at_parameter(finer, long_z, on_finer.steps, along, free)
    moves = by_Omega | (free & (along is not None) & (steps[:, finer.parameter_index] != 0.0))
    errors, floors = _step_errors(finer, long_z, steps, moves), np.zeros(len(z))
    errors[0] = np.maximum(errors[0], problem.round_off * Omega)
    near = _largest(errors, Omega) < NEAR_ROUND_OFF
    if near.any():  # no better than the response to rounding, and than what rounded constants do
        noise = _at_parameter(finer, long_z, on_finer.response(), along, free)
        floor = _step_errors(finer, long_z, noise, moves)
        floor[0], floor[1] = np.maximum(floor[0], problem.round_off * Omega), np.maximum(floor[1], problem.round_off)
        errors, floors = np.where(near, np.maximum(errors, floor), errors), np.where(near, _largest(floor, Omega), 0.0)
        for i in np.flatnonzero(near & by_Omega).tolist():
            if tangents is not None:
                errors[2, i] = max(errors[2, i], _by_constants(problem, z[i], tangents[i]))
    columns = *errors[:2].tolist(), floors.tolist(), errors[2].tolist()
    found = [ErrorEstimate(*one) for one in zip(*columns, strict=True)]
    return [(error, Refinement(finer, better)) for error, better in zip(found, long_z - steps, strict=True)]


def _at_parameter(problem: Problem, z: Array, steps: Array, along: Array | None, free: NDArray[np.bool_]) -> Array:
    """Steps brought back to the parameter along tangents where `free`, but for the neighbourhood of a fold."""
    if along is None:
        return steps
    index, sizes = problem.parameter_index, np.array([problem.parameter_size(one) for one in z])
    back = free & (np.abs(along[:, index]) > FOLD * sizes)
    ratios = np.divide(steps[:, index], along[:, index], out=np.zeros(len(z)), where=back)
    found = np.asarray(steps - along * ratios[:, None])
    found[back, index] = 0.0  # but for round-off
    return found


def _step_errors(problem: Problem, z: Array, steps: Array, with_parameter: NDArray[np.bool_]) -> Array:
    """As `step_error` of several states: errors of Omega, of the profile and of the parameter, shape (3, states)."""
    errors = np.zeros((3, len(z)))
    errors[0] = [abs(problem.frequency_step(*one)) for one in zip(z, steps, strict=True)]
    errors[1] = problem.profile_changes(z, steps)
    for i in np.flatnonzero(with_parameter).tolist():
        errors[2, i] = abs(steps[i, problem.parameter_index]) / problem.parameter_size(z[i])
    errors *= SAFETY
    return errors


def _largest(errors: Array, Omega: Array) -> Array:
    """The largest of the three errors of each state, with that of Omega made relative."""
    return np.asarray(np.max([errors[0] / Omega, errors[1], errors[2]], axis=0))


def no_better(error: ErrorEstimate, response: ErrorEstimate, problem: Problem, z: Array) -> ErrorEstimate:
    """The error, but not below the response to rounding, also of constants."""
    Omega = problem.frequency(z)
    floor = replace(
        response,
        Omega=max(response.Omega, problem.round_off * Omega),
        profile=max(response.profile, problem.round_off),
    )
    return ErrorEstimate(
        max(error.Omega, floor.Omega),
        max(error.profile, floor.profile),
        floor.relative(Omega),
        max(error.parameter, floor.parameter),
    )


def _by_constants(problem: Problem, z: Array, tangent: Array) -> float:
    """Relative error of the parameter at a held Omega by rounded constants, which put Omega off at a held parameter."""
    by_Omega = abs(problem.frequency_step(z, tangent)) / problem.frequency(z)
    by_parameter = abs(float(tangent[problem.parameter_index])) / problem.parameter_size(z)
    return problem.round_off * by_parameter / max(by_Omega, EPSILON)
