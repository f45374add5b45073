"""Other ways to a first solution where the correctors do not reach it from the guess.

Newton's method first, where it has not been tried; then a short continuation: the problem is solved at an easier value
of one of its parameters, ten or a hundred times as large or as small, and followed from there to the requested values.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

from casadi_skin.follow.boundary_space import BoundarySpace
from casadi_skin.follow.settings import Point
from casadi_skin.follow.solution import Solution
from casadi_skin.solve.guesses import Guess
from casadi_skin.solve.refined import BoundaryError

FACTORS = (10.0, 0.1)  # of a parameter, and their squares, at which the problem may be easier
MOST_PARAMETERS = 3  # that are tried
MOST_POINTS = 60  # of a continuation

First = Callable[[BoundarySpace, Guess], Point]


def other_ways(space: BoundarySpace, guess: Guess, first: First) -> tuple[Solution | None, str]:
    """A solution by another way with its description, or None with the ways that failed, in words.

    Arguments:
        space: of the solution that is sought.
        guess: where it was sought.
        first: makes the first point of a space near a guess, quickly; raises BoundaryError.
    """
    tried = []
    by_newton = replace(space, method=replace(space.method, corrector="newton"))
    if space.method.corrector != "newton":
        tried.append("Newton's method")
        found = _found(by_newton, guess, first)
        if found is not None:
            return replace(found, found_by=tried[-1]), tried[-1]
    for name, value in _parameters(space):
        starts = []
        for factor in FACTORS:
            for easier_value in (factor * value, factor**2 * value):
                starts.append(f"{easier_value:g}")
                easier = _found(_at(by_newton, name, easier_value), guess, first)
                if easier is None:
                    continue
                reached = _followed(easier, name, value)
                found = None if reached is None else _found(by_newton, reached, first)
                if found is not None:
                    words = f"{name} followed from {easier_value:g} to {value:g}"
                    return replace(found, found_by=words), words
                break  # the branch does not come here: nor does it from farther off
        tried.append(f"{name} followed from {', '.join(starts)}")
    names = " or ".join(name for name, _ in _parameters(space))
    hint = f"; not tried: {names} by arclength past folds, with follow from a solution at another value"
    return None, "; ".join(tried) + (hint if names else "")


def _parameters(space: BoundarySpace) -> Iterator[tuple[str, float]]:
    """Parameters that may be followed to their values."""
    statement = space.statement
    fixed = [(name, value) for name, value in statement.values.items() if name not in statement.free and value]
    yield from fixed if len(fixed) <= MOST_PARAMETERS else ()


def _at(space: BoundarySpace, name: str, value: float) -> BoundarySpace:
    return replace(space, statement=space.statement.with_parameters(**{name: value}))


def _found(space: BoundarySpace, guess: Guess, first: First) -> Solution | None:
    try:
        return Solution(space, first(space, guess))
    except BoundaryError:
        return None


def _followed(easier: Solution, name: str, value: float) -> Solution | None:
    try:
        branch = easier.follow(name, value, max_points=MOST_POINTS, until=_turns)
    except BoundaryError:
        return None
    reached: Solution = branch.solutions[-1]
    return reached if reached.parameters[name] == value else None


def _turns(solution: Solution) -> bool:
    """Whether the branch turns back here: it does not come to the value."""
    return bool(solution.point.special)
