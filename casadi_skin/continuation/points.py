"""What walks of a branch deal in: settings, points, and the reasons for which a walk ends."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum
from typing import Protocol

from casadi_skin.bvp.problem import Array, OrbitProblem
from casadi_skin.correctors.ladder import ErrorEstimate, Refinement

SAME = 1e-12  # relative difference below which a point walked is the one asked for


@dataclass(frozen=True)
class WalkSettings:
    """What the walk aims for and refuses; lengths in the relative metric, angles in degrees."""

    parameter_max: float  # the walk ends at this value of the free parameter; its sign is the direction
    tolerance: float  # relative error of Omega and of the profile at every point
    at: tuple[float, ...] = ()  # values of the free parameter at which points are wanted exactly
    first_step: float = 0.01
    max_step: float = 0.2
    max_parameter_step: float = 1.0 / 30.0  # of parameter_max: points to draw, and to see stability change between
    min_step: float = 1e-7
    max_points: int = 20_000
    guard_distance: float = 0.08  # of the step, between predicted and corrected point
    guard_angle: float = 14.0
    aim_angle: float = 8.0


class End(Enum):
    """Why a walk ended, in words."""

    REACHED = "reached the end asked for"
    NO_STEP = "no step, however short, stays on the family"
    RESOLUTION = "the orbit needs a finer discretisation than the finest there is"
    RETURNED = "the family came back to zero amplitude"
    POINTS = "the limit on the number of points was reached"
    FLOW = "the flow map of the variational system cannot reach the tolerance"


@dataclass(frozen=True)
class Point:
    """A converged point of the branch with its unit tangent; `step` is the step to try next."""

    problem: OrbitProblem
    z: Array
    tangent: Array
    error: ErrorEstimate
    step: float
    iterations: int
    requested: bool = False
    walked: bool = True  # a point of the walk itself; others lie between two of these
    better: Refinement | None = None  # the point one Newton step nearer to the next finer rung
    at_round_off: bool = False  # the tolerance is below what round-off leaves of the point

    @property
    def parameter(self) -> float:
        """Value of the free parameter."""
        return float(self.z[self.problem.parameter_index])

    @property
    def Omega(self) -> float:
        """Frequency."""
        return self.problem.frequency(self.z)

    def snapped(self, values: tuple[float, ...]) -> Point:
        """This point, requested and with its parameter exact where that is one of `values` but for round-off."""
        for value in values:
            if is_any(self.parameter, (value,)):
                z = self.z.copy()
                z[self.problem.parameter_index] = value
                return replace(self, z=z, requested=True)
        return self


def is_any(parameter: float, values: tuple[float, ...]) -> bool:
    """Whether the parameter is one of `values` but for round-off."""
    return any(abs(parameter - value) <= SAME * abs(value) for value in values)


class Walk(Protocol):
    """A way along a branch: an iterator over its points in arclength order.

    `end` tells why it stopped, `detail` where; `missed` lists requested values at which no point was found. `history`
    holds the last few points walked: a walk made from them goes on exactly as the one that was broken off.
    """

    history: tuple[Point, ...]
    end: End | None
    detail: str
    missed: list[float]

    def __iter__(self) -> Iterator[Point]: ...
