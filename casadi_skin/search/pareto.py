"""The Pareto front of two quantities: points where neither improves unless the other worsens.

Bounds of the second quantity are swept, evenly along the line between the ends (Haimes, Lasdon and Wismer 1971): a sum
with weights leaves out what is not convex.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casadi_skin.model.arguments import whole
from casadi_skin.model.result import Result, in_turn
from casadi_skin.search.conditions import checked_conditions
from casadi_skin.search.design import Design
from casadi_skin.search.design_problem import DesignProblem
from casadi_skin.search.designs import best_design
from casadi_skin.zero.problem import Array


@dataclass(frozen=True, eq=False)
class ParetoFront(Result):
    """Points of the front by ascending second quantity.

    Attributes:
        points: the designs.
        values: of both quantities, shape (points, 2).
        dominated: number of designs removed.
        complete: whether every sweep found an optimum.
        names: of both quantities.
    """

    points: tuple[Design, ...]
    values: Array
    dominated: int
    complete: bool
    names: tuple[str, str]

    def __repr__(self) -> str:
        return f"<ParetoFront: {len(self.points)} points of {self.names[0]} against {self.names[1]}>"


@in_turn
def pareto_front(
    first: str,
    second: str,
    of: Any,
    *,
    over: Sequence[str],
    points: int = 10,
    starts: int = 1,
    seed: int = 0,
    tolerance: float = 1e-8,
    subject_to: Sequence[Any] = (),
    bounds: Mapping[str, Any] | None = None,
) -> ParetoFront:
    """The front of the least `first` against the least `second` quantity, by a sweep of bounds.

    Arguments:
        first, second: names of quantities, or formulas.
        points: number of points, evenly along the line between the ends, both quantities over their ranges.
        of, over, starts, seed, tolerance, subject_to, bounds: as in `optimise`; each point starts from the one
            before as well.

    Raises:
        ValueError, TypeError: arguments that are not accepted, or an end of the front without an optimum.
    """
    whole("points", points, 2)
    checked_conditions(subject_to, (str, Callable), "a function of what is located", "subject_to")

    def least(quantity: str, near: Sequence[Design] = (), *held: tuple[str, None, float]) -> Design:
        known = [*subject_to, (first, None, None), (second, None, None), *held]
        problem = DesignProblem.of(quantity, of, over, known, bounds, False)
        return best_design(problem, [*(one.path[-1] for one in near), *problem.places(starts, seed)], tolerance)

    def both(design: Design) -> Array:
        return np.array([design.conditions[name][0] for name in (first, second)])

    ends = [least(second), least(first)]
    for end in ends:
        if not end.found:
            raise ValueError(f"pareto_front: the least {end.quantity} has no optimum: {end.reason}")
    # The first point has the least `first` of those with the least `second`; the others are evenly along the line from
    # this to the last one, both quantities over their ranges, and are the best there.
    designs = [least(first, ends[:1], (second, None, both(ends[0])[1]))]
    near = designs[0] if designs[0].found else ends[0]
    ranges, limits = np.abs(both(near) - both(ends[1])), np.array([both(near), both(ends[1])])
    if np.all(ranges > 0.0):
        place = f"({second})/{ranges[1]:.17g} - ({first})/{ranges[0]:.17g}"
        begin, stop = (limits / ranges) @ np.array([-1.0, 1.0])
        for limit in np.linspace(begin, stop, points)[1:-1]:
            designs.append(least(first, [near], (place, None, limit)))
            near = designs[-1] if designs[-1].found else near
    every = [*designs, ends[1]]
    found = [one for design in every if design.found for one in (design, *design.others)]
    values = np.array([both(one) for one in found])
    kept = undominated(values)
    return ParetoFront(
        tuple(found[k] for k in kept), values[kept], len(found) - len(kept), all(one.found for one in every),
        (first, second),
    )  # fmt: skip


def undominated(values: Array) -> list[int]:
    """Rows than which no other is as good in both columns and better in one, by the second; of equal ones the first."""
    found = list[int]()
    for k, row in enumerate(values):
        no_worse, same = np.all(values <= row, axis=1), np.all(values == row, axis=1)
        if not (np.any(no_worse & ~same) or np.any(same[:k])):
            found.append(k)
    return sorted(found, key=lambda k: float(values[k, 1]))
