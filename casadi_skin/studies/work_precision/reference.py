"""What true errors are measured against: a family far below every tolerance, confirmed by independent methods."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from casadi_skin.bvp.problem import Array
from casadi_skin.continuation.points import Point
from casadi_skin.orbits.family import Family
from casadi_skin.orbits.follow import Following
from casadi_skin.orbits.multipliers import accelerations
from casadi_skin.orbits.orbit import Orbit
from casadi_skin.orbits.request import family_request
from casadi_skin.results.tables import Cell
from casadi_skin.stability.flow import FlowMap, OrbitState
from casadi_skin.stability.gauss_flow import GaussFlow, GaussMap
from casadi_skin.stability.multipliers import floquets
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.result import Floquet
from casadi_skin.stability.splitting import SplittingFlow
from casadi_skin.stability.stepping import StepMap

TIGHTEST = 1e-13
TIGHTEST_FLOW = 1e-14
MORE_RUNGS = 2  # of the levels of harmonics above the one that meets the tightest tolerance
POLISHING = 2  # Newton steps that take away what the corrector left
PHASES = np.linspace(0.0, np.pi, 129)  # half of the period: the other half repeats it
TIGHT_DEGREE = 8


class TightFlow(GaussFlow):
    """Gauss-Legendre collocation of order 16, which no scene can ask for and none of the flows compared shares."""

    orders = (2 * TIGHT_DEGREE,)

    def _build(self, steps: int) -> StepMap:
        return GaussMap(self.jacobian, steps, self.model.order, TIGHT_DEGREE)


@dataclass(frozen=True)
class Errors:
    """Largest relative errors of Omega, profile and mu; of mu relative to max(1, |mu|), nan where there is none."""

    Omega: float
    profile: float
    mu: float = np.nan


@dataclass(frozen=True)
class Truth:
    """An orbit as it is compared: S, Omega, displacements at PHASES, and mu beside the trivial one."""

    S: float
    Omega: float
    displacements: Array
    mu: ComplexArray

    def errors_of(self, other: Truth) -> Errors:
        """How far the other orbit is from this one."""
        largest = np.max(np.abs(self.displacements))
        profile = float(np.max(np.abs(other.displacements - self.displacements)) / largest)
        return Errors(abs(other.Omega - self.Omega) / self.Omega, profile, mu_distance(self.mu, other.mu))


def mu_distance(true: ComplexArray, given: ComplexArray) -> float:
    """Largest distance of the values, paired at least cost, relative to max(1, |mu|); nan where there are none."""
    if true.size == 0 or true.shape != given.shape:
        return np.nan
    from scipy.optimize import linear_sum_assignment

    distances = np.abs(true[:, None] - given[None, :]) / np.maximum(1.0, np.abs(true))[:, None]
    return float(np.max(distances[linear_sum_assignment(distances)]))


def largest(errors: Sequence[Errors]) -> Errors:
    """The largest of each error."""
    columns = zip(*((e.Omega, e.profile, e.mu) for e in errors), strict=True)
    return Errors(*(float(max(column)) for column in columns))


def seen(orbit: Orbit, mu: ComplexArray) -> Truth:
    """An orbit with its mu as it is compared."""
    return Truth(orbit.S, orbit.Omega, orbit.evaluate(PHASES / orbit.Omega), mu)


def floquets_along(tools: Family, flow: FlowMap, points: Sequence[Point], tolerance: float) -> list[Floquet]:
    """Stability of points of a family by a flow, nothing done about the errors of the points.

    No mu at |gamma| = 1, where one site moves. Raises FlowError.
    """
    if tools.coordinates.core.sites == 1:
        return [Floquet(np.zeros(0, complex), np.zeros(0), 0.0, 2) for _ in points]
    states = [OrbitState(point.problem, point.z) for point in points]
    return floquets(flow, states, lambda orbits: accelerations(tools, orbits), tolerance)


def requested_orbits(walk: Following) -> list[Orbit]:
    """Orbits at the S that were asked for; raises ArithmeticError with the reason where the family has not all."""
    branch = walk.branch()
    if not branch.complete:
        raise ArithmeticError(branch.reason)
    return [orbit for orbit in branch.orbits if orbit.point.requested]


def walked(tools: Family, stability: bool = False) -> Following:
    """A walk to its end."""
    walk = Following(tools, stability)
    for _ in walk:
        pass
    return walk


class Reference:
    """The orbits of a family at the S asked for, by odd cosines, and their mu, by a flow of order 16.

    Confirmed by Gauss-Legendre collocation of the orbits and by the splitting. Raises ArithmeticError where the family
    does not reach them.
    """

    def __init__(self, request: FamilyRequest) -> None:
        chain, mode, amplitude_max, at = request.chain, request.mode, request.amplitude_max, request.at
        tight = family_request(chain, mode, amplitude_max, at, TIGHTEST, "trigonometric", "newton")
        self.space = Family(tight)
        found = requested_orbits(walked(self.space))
        self.orbits = [self._finer(orbit) for orbit in found]
        self.truths = [seen(o, mu) for o, mu in zip(self.orbits, self._mu(self.flow), strict=True)]
        collocated = requested_orbits(walked(Family(replace(tight, transcription="gauss"))))
        mus = self._mu(SplittingFlow(self.space.model, TIGHTEST_FLOW))
        self.second = [seen(orbit, mu) for orbit, mu in zip(collocated, mus, strict=True)]

    @cached_property
    def flow(self) -> TightFlow:
        """The flow of order 16."""
        return TightFlow(self.space.model, TIGHTEST_FLOW)

    @cached_property
    def agreement(self) -> Errors:
        """Largest differences between the reference and the methods that confirm it."""
        return self.errors_of(self.second)

    @property
    def harmonics(self) -> int:
        """The most odd cosines of an orbit."""
        return max(orbit.point.problem.resolution for orbit in self.orbits)

    def errors_of(self, others: Sequence[Truth]) -> Errors:
        """Largest true errors of other orbits; raises ArithmeticError where they are not at the same S."""
        if [t.S for t in others] != [t.S for t in self.truths]:
            raise ArithmeticError(
                f"{len(others)} points at the S asked for, where the reference has {len(self.truths)}"
            )
        return largest([a.errors_of(b) for a, b in zip(self.truths, others, strict=True)])

    def rows(self) -> list[dict[str, Cell]]:
        """Rows of reference.csv: each orbit and how far the confirming methods are from it."""
        rows: list[dict[str, Cell]] = []
        for orbit, truth, second in zip(self.orbits, self.truths, self.second, strict=True):
            e = truth.errors_of(second)
            differences = (e.Omega, e.profile, "" if e.mu != e.mu else e.mu)
            values: tuple[Cell, ...] = (truth.S, truth.Omega, orbit.point.problem.resolution, *differences)
            rows.append(dict(zip(REFERENCE_COLUMNS, values, strict=True)))
        return rows

    def _mu(self, flow: FlowMap) -> list[ComplexArray]:
        points = [orbit.point for orbit in self.orbits]
        return [f.mu for f in floquets_along(self.space, flow, points, TIGHTEST_FLOW)]

    def _finer(self, orbit: Orbit) -> Orbit:
        """The orbit with more harmonics, corrected to round-off at its value of the parameter."""
        point, levels, point_solver = orbit.point, self.space.levels, self.space.point_solver
        problem, z = point.problem, point.z
        for _ in range(MORE_RUNGS):
            finer = levels.finer(problem)
            if finer is not None:
                problem, z = finer, problem.prolong(z, finer)
        row = problem.parameter_row()
        z = levels.corrector(problem).correct(z, row, point.parameter).z
        for _ in range(POLISHING):
            z = z - point_solver.factor(problem, z, row)(np.append(problem.evaluate(z)[0], 0.0))
        z[problem.parameter_index] = point.parameter
        return Orbit(self.space, replace(point, problem=problem, z=z, better=None), asked_S=orbit.S)


REFERENCE_COLUMNS = ("S", "Omega", "harmonics", "Omega_difference", "profile_difference", "mu_difference")
