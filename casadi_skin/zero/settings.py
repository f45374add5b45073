"""Settings and points of a continuation, and the reasons for which it ends."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property
from typing import Any

import numpy as np

from casadi_skin.zero.problem import EPSILON, Array, Problem, Scalar

# Of the largest speed of a solution to its mean. Canards have 22 to 160, FitzHugh and Nagumo's pulses 8, Lorenz' cycles
# 2 to 15: with meshes that move from 3 on, and not from 20 on, branches have half the points; from 1 on some end early.
LAYER_SPEED_RATIO, MOVING_SPEED_RATIO = 20.0, 3.0


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

    problem: Any
    z: Array


SAME_POINT_RTOL = 1e-12  # relative difference below which a point walked is the requested one
NEXT_POINT_DISTANCE = 1e-10  # and its distance along the branch
RESOLVED_CHANGE_UNITS = 1e-2  # units in the last place that a value changes by over that distance at least


@dataclass(frozen=True)
class Target:
    """A value of the free parameter or of Omega at which a point is wanted exactly."""

    held: Scalar
    value: float

    def unknown(self, problem: Problem) -> tuple[int, float]:
        """The place in z of the held unknown, and its value."""
        return problem.index_of(self.held), problem.unknown_at(self.held, self.value)

    def meets(self, point: Point) -> bool:
        """Whether a point is at the value but for round-off, and next to where the branch has it.

        The second says more where the value hardly changes along the branch; where it changes by less than its own
        round-off, no point is known to be there.
        """
        index, value = self.unknown(point.problem)
        gap = abs(float(point.z[index]) - value)
        next_to = NEXT_POINT_DISTANCE * abs(float(point.tangent[index]))
        return (
            gap <= min(SAME_POINT_RTOL * abs(value), next_to)
            and next_to >= EPSILON * abs(value) * RESOLVED_CHANGE_UNITS
        )


@dataclass(frozen=True)
class ContinuationSettings:
    """Aims and limits of a continuation; lengths in the relative metric, angles in degrees."""

    parameter_max: float  # the walk ends at this value of the free parameter; its sign is the direction
    tolerance: float  # relative error of Omega and of the profile at every point
    at: tuple[Target, ...] = ()  # where points are wanted exactly
    Omega_end: float | None = None  # the walk ends at this value of Omega as well
    first_step: float = 0.01
    max_step: float = 0.2
    max_parameter_step: float = 1.0 / 30.0  # of parameter_max: points to draw, and to see stability change between
    min_step: float = 1e-7
    max_points: int = 20_000
    parameter_min: float = 0.0  # of parameter_max: the walk ends where it comes back to this
    closing: bool = False  # from there it goes on as far to the other side, as it may close
    tiny_first: bool = True  # a point next to the start is among the first ones, where that has no amplitude
    rounds_corners: bool = False  # whether a step across which the determinant changes sign is looked into
    guard_distance: float = 0.08  # of the step, between predicted and corrected point
    guard_angle: float = 14.0
    aim_angle: float = 8.0
    layer_angles: float = 3.75  # times these angles, where a solution has layers: they turn any tangent as they move

    @property
    def ends(self) -> tuple[Target, ...]:
        """Ends of the continuation, whichever comes first."""
        end = Target(Scalar.PARAMETER, self.parameter_max)
        return (end,) if self.Omega_end is None else (end, Target(Scalar.OMEGA, self.Omega_end))

    @property
    def lowest(self) -> float:
        """Of parameter_max: where the walk ends at the latest when it comes back."""
        return -1.0 if self.closing else self.parameter_min

    @property
    def wanted(self) -> dict[Target, bool]:
        """All places at which the continuation stops, and whether the point there was requested."""
        return dict.fromkeys(self.ends, False) | dict.fromkeys(self.at, True)


class End(Enum):
    """Why a walk ended, in words."""

    REACHED = "reached the end asked for"
    NO_STEP = "no step, however short, stays on the family"
    RESOLUTION = "the orbit needs a finer discretisation than the finest there is"
    RETURNED = "the family came back to zero amplitude"
    CLOSED = "the branch closed on itself: it is a closed curve, and all of it is there"
    AWAY = "the branch came back and went on beyond its start, as far as it was to go there"
    HOPF = "the cycle shrinks to an equilibrium at a Hopf point"
    REJOINED = "the orbits come back to those that they left"
    UNBOUNDED = "the period grows without bound"
    BOUND = "a bound of the problem is met"
    TAKENS = "the Hopf points end at a Bogdanov-Takens point, with frequency zero"
    BAUTIN = "the cycles shrink to an equilibrium at a generalized Hopf point"
    HOPF_HOPF = "the cycles shrink to an equilibrium at a Hopf-Hopf point"
    ZERO_HOPF = "the cycles shrink to an equilibrium at a zero-Hopf point"
    RESONANCE_ONE = "the tori end at a 1:1 resonance"
    RESONANCE_TWO = "the tori end at a 1:2 resonance"
    JUMP = "the equations jump there"
    POINTS = "the limit on the number of points was reached"
    TIME = "the time limit is over"
    STILL = "the parameter no longer changes in double precision while the solution does"
    LIMIT = "S no longer changes in double precision while the period grows"
    FLOW = "the flow map of the variational system cannot reach the tolerance"


@dataclass(frozen=True)
class Point:
    """A converged point of the branch with its unit tangent; `step` is the step to try next.

    `problem` is of the kind that its space states.
    """

    problem: Any
    z: Array
    tangent: Array
    error: ErrorEstimate
    step: float
    iterations: int
    requested: bool = False
    walked: bool = True  # a point of the walk itself; others lie between two of these
    along: float = 0.0  # how far it lies after the point walked before it, where the continuation went on past it
    located: bool = False  # a special point between two of the continuation
    better: Refinement | None = None  # the point one Newton step nearer to the next finer level
    at_round_off: bool = False  # the tolerance is below the round-off of the point
    special: str = ""  # the kind of a special point that was located
    angle: float | None = (
        None  # of its critical pair: imaginary part of eigenvalues, angle of multipliers; None unknown
    )

    @property
    def parameter(self) -> float:
        """Value of the free parameter."""
        return float(self.z[self.problem.parameter_index])

    @cached_property
    def speed_ratio(self) -> float:
        """The largest speed of the solution, of its mean."""
        return float(self.problem.speed_ratio(self.z))

    def is_at(self, other: Point) -> bool:
        """Whether both are one point of the branch, whatever else is known of them."""
        return self.z is other.z and self.tangent is other.tangent

    @property
    def moves(self) -> bool:
        """Whether the mesh may move with the layers along the branch, and there are some."""
        return self.problem.may_move and self.speed_ratio > MOVING_SPEED_RATIO

    @property
    def Omega(self) -> float:
        """Frequency."""
        return float(self.problem.frequency(self.z))

    @property
    def parameter_rate(self) -> float:
        """Relative change of the free parameter along the branch, per that of Omega."""
        by_Omega = abs(self.problem.frequency_step(self.z, self.tangent)) / self.Omega
        by_parameter = abs(float(self.tangent[self.problem.parameter_index])) / abs(self.parameter)
        return by_parameter / by_Omega if by_Omega > 0 else np.inf

    def marked(self, special: str, **changes: Any) -> Point:
        """A point there that is none of the continuation's own, special by a kind, with other fields changed."""
        return replace(self, special=special, walked=False, requested=False, **changes)

    def snapped(self, targets: tuple[Target, ...]) -> Point:
        """This point, requested and with its value exact where it meets any of `targets`."""
        met = [target for target in targets if target.meets(self)]
        if not met:
            return self
        z = self.z.copy()
        for target in met:
            index, value = target.unknown(self.problem)
            z[index] = value
        return replace(self, z=z, requested=True)
