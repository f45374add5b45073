"""One family as a space of solutions, each part built on first use: equations by resolution, start, branch."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from casadi_skin.follow.arclength import Continuation
from casadi_skin.follow.point import PointSolver, with_small_components
from casadi_skin.follow.series import CONFIRMED_TOGETHER, SeriesContinuation
from casadi_skin.follow.solution import Orbit
from casadi_skin.follow.space import FAMILY, SolutionSpace, of_last_points
from casadi_skin.follow.special_points import folds_between
from casadi_skin.model import methods
from casadi_skin.model.conserved import SymmetryClass, symmetry_class
from casadi_skin.model.expressions import site_numbers
from casadi_skin.solve.ipopt import CORRECTORS, ArbitratedCorrector
from casadi_skin.solve.levels import Levels
from casadi_skin.solve.newton import Corrector
from casadi_skin.stability.family_stability import FamilyStability
from casadi_skin.stability.result import Floquet
from casadi_skin.zero.butcher import TABLES
from casadi_skin.zero.collocation import CollocationProblem
from casadi_skin.zero.cosines import PolynomialForm, Recursion, TrigonometricProblem
from casadi_skin.zero.family import TWO_PI, FamilyRequest
from casadi_skin.zero.kinds import Unresolved
from casadi_skin.zero.problem import Array, Indices, Problem
from casadi_skin.zero.settings import End, Point
from casadi_skin.zero.shooting import ShootingProblem

FEW_HARMONICS = (methods.FEWEST_COSINES, 6, 8, 10, 12, 14, 16, 20, 24, 28, 32, 40, 48, 64)
HARMONICS_OFFERED = (*FEW_HARMONICS, 80, 96, 128, 160, 192, 256)
MANY_HARMONICS = (320, 384, 512)  # where few sites make them cheap
INTERVALS_OFFERED = (2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128)
CVODES_DIGITS = (8, 10, 12, 14, 15)  # of its local tolerance: fewer cost as much, and their noise refuses more steps
SHOOTING_SHARE = 0.03  # of the tolerance, local: an orbit's error is 10 to 1000 local tolerances
SHOOTING_NOISE = 10.0  # local tolerances, which a corrector of shooting may leave
ROUND_OFF = 2e-15  # of a residual relative to the state, per square of the resolution
LARGEST_FAMILY_SIZE = 10_000_000  # positions times harmonics squared: about a gigabyte
SMALL_UNKNOWNS = 1000  # unknowns up to which the cost of a call of Ipopt does not depend on their number
CHEAP_SYSTEM_SIZE = 1_000_000  # the same for systems solved in a fraction of a second
SERIES_PRECISION = 1e-6  # of a residual before Newton's step
SERIES_ORDERS = 24  # cost of a step over its length is flat between 20 and 35
JUMP_PHASES = np.linspace(0.0, TWO_PI, 401)  # at which an orbit is looked at for jumps
SLOW_PERIOD_FACTOR = 3.0  # times the period of the linear mode
TIE_RTOL = 1e-10  # relative difference of displacements that count as equal
UNCHANGED_S_RATE = 1e-13  # a relative change of S, per that of Omega, that no longer shows


class Family(FamilyStability, SolutionSpace):
    """The equations of one family and how their unknowns are read (see `SolutionSpace`).

    Each part is built on first use; one object serves any number of continuations of the same request.
    """

    connects = FAMILY
    parameter = "S"
    start_is_limit = True  # the linear mode at S = 0 is not an orbit of the family
    locates_folds = False  # while the family is followed; `Branch.special_points` locates them on first use

    def __init__(self, request: FamilyRequest) -> None:
        super().__init__(request)
        self._recursions: dict[int, Recursion] = {}

    # Equations ------------------------------------------------------------------------------------------------------

    @cached_property
    def symmetry(self) -> SymmetryClass:
        """Part of the period that is unknown."""
        return self.request.method.symmetry or symmetry_class(self.coordinates.scaled)

    @cached_property
    def levels(self) -> Levels:
        """Discretisations from coarse to fine with their correctors."""
        transcription = self.request.method.transcription
        if transcription == methods.SHOOTING:
            useful = [d for d in CVODES_DIGITS[:-2] if 10.0**-d <= SHOOTING_SHARE * self.tolerance]
            return Levels(self._problem, self._corrector, (*useful, *CVODES_DIGITS[-2:]))
        if transcription in TABLES:
            return Levels(self._problem, self._corrector, INTERVALS_OFFERED)
        positions = self.coordinates.mode.size
        fits = [H for H in HARMONICS_OFFERED if positions * H**2 <= LARGEST_FAMILY_SIZE]
        fits += [H for H in MANY_HARMONICS if positions * H**2 <= CHEAP_SYSTEM_SIZE]
        return Levels(self._problem, self._corrector, tuple(fits or HARMONICS_OFFERED[:2]))

    def _problem(self, resolution: int) -> Problem:
        own = self.coordinates.transcription(resolution)
        if own is not None:
            return own
        scaled, transcription = self.coordinates.solved, str(self.request.method.transcription)
        if transcription == methods.TRIGONOMETRIC:
            return TrigonometricProblem(scaled, resolution)
        if transcription == methods.SHOOTING:
            return ShootingProblem(scaled, resolution, self.symmetry)
        table = TABLES[transcription](self.request.degree)
        return CollocationProblem(scaled, resolution, self.symmetry, table)

    @property
    def corrector_tolerance(self) -> float:
        """Residual that a corrector may leave, relative to the state, where round-off allows it."""
        return float(np.clip(1e-2 * self.tolerance, 1e-12, 1e-6))

    def _corrector(self, problem: Problem) -> Corrector:
        tolerance, name = self.corrector_tolerance, self.request.method.corrector
        tolerance = max(tolerance, SHOOTING_NOISE * problem.noise)
        if name == "ipopt":
            tolerance = max(tolerance, ROUND_OFF * problem.resolution**2)
        if name == "ipopt" and not problem.noise:
            series = self.request.method.walker == "series"
            together = CONFIRMED_TOGETHER if series and problem.size <= SMALL_UNKNOWNS else 1
            return ArbitratedCorrector(problem, tolerance, together=together)
        return CORRECTORS[name](problem, tolerance)

    # The branch -----------------------------------------------------------------------------------------------------

    @cached_property
    def point_solver(self) -> PointSolver:
        """The solver of points of the family at its tolerance."""
        return PointSolver(self.levels, self.request.continuation_settings())

    @cached_property
    def start(self) -> Point:
        """The linear mode at S = 0 with the tangent of the family."""
        return self.point_solver.start(self.coordinates.mode, self.coordinates.start_unknown)

    def continuation(self, history: tuple[Point, ...], reported: tuple[Point, ...] = ()) -> Continuation:
        """The continuation from its last points, the start among them, and from points reported after these."""
        if self.request.method.walker != "series":
            return super().continuation(history, reported)
        tolerance = self.corrector_tolerance

        def precision(problem: Problem) -> float:
            allowed = max(tolerance, ROUND_OFF * problem.resolution**2)
            return min(0.1 * math.sqrt(allowed), SERIES_PRECISION)  # Newton's step squares it

        return SeriesContinuation(self.point_solver, history, self._recursion, precision, reported)

    def _recursion(self, problem: Any) -> Recursion:
        """Power series at one resolution, made once."""
        if problem.resolution not in self._recursions:
            form = PolynomialForm.of(self.coordinates.scaled)
            self._recursions[problem.resolution] = problem.recursion(form, SERIES_ORDERS)
        return self._recursions[problem.resolution]

    @property
    def held_names(self) -> tuple[str, ...]:
        """Names of the quantities that `target` accepts."""
        return "S", "Omega", "period"

    def fraction(self, value: float) -> float:
        """The free parameter of a value of S."""
        return self.coordinates.parameter_of(value)

    @property
    def to(self) -> float:
        """S at which the family ends."""
        return self.request.amplitude_max

    def requested_values(self) -> dict[str, Sequence[float]]:
        """Values at which orbits are wanted, by name."""
        targets = self.request.targets
        return {"S": targets.at, "Omega": targets.at_Omega, "period": targets.at_period}

    def value(self, name: str, point: Point) -> float:
        """S, Omega or the period of a point; exactly the requested value at a requested point."""
        if name == "S":
            return self.request.S_of(point.parameter)
        return point.Omega if name == "Omega" else self.request.period_of(point.Omega)

    def special_between(self, before: Point, after: Point, gaps: list[Unresolved]) -> Iterator[Point]:
        """Folds on the stretch between two points, where S turns back."""
        yield from folds_between(self.point_solver, before, after)

    def parameter_error(self, point: Point) -> float:
        """Estimated error of S at a special point."""
        relative = point.error.parameter or point.error.relative(point.Omega)
        return relative * self.coordinates.S_rate * self.value("S", point)

    def stop(self, point: Point) -> tuple[End | None, str]:
        """LIMIT where the only requests left are values of S that the family does not reach; JUMP where forces do."""
        jumps = self.coordinates.jump(lambda: math.sqrt(self.value("S", point)) * self.positions(point, JUMP_PHASES))
        if jumps:
            return End.JUMP, jumps
        targets = self.request.targets
        if SLOW_PERIOD_FACTOR * point.Omega > self.start.Omega or targets.period_max is not None:
            return None, ""
        slowest = min((*targets.at_Omega, *(TWO_PI / period for period in targets.at_period)), default=np.inf)
        at_limit = point.Omega < slowest and point.parameter_rate <= UNCHANGED_S_RATE
        return (End.LIMIT if at_limit else None), ""

    # Values ---------------------------------------------------------------------------------------------------------

    def solution(self, point: Point, floquet: Floquet | None = None, exact: Mapping[str, float] | None = None) -> Orbit:
        """The orbit of a point, with its stability where that is known and values that it has exactly."""
        return Orbit(self, point, exact or {}, known_floquet=floquet)

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the positions at `output_sites`."""
        return self.coordinates.position_names

    @property
    def output_sites(self) -> Indices:
        """Numbers of the positions in files and pictures."""
        return self.coordinates.output_sites

    @property
    def S_rate(self) -> float:
        """Relative change of S per that of the free parameter."""
        return self.coordinates.S_rate

    def parameters(self, point: Point) -> dict[str, float]:
        """Values of the parameters of the model by name."""
        return dict(self.coordinates.parameters)

    def interval(self, point: Point) -> tuple[float, float]:
        """From phase zero over the period."""
        return 0.0, self.value("period", point)

    def span(self, point: Point) -> tuple[float, float]:
        """From phase zero over the part of the period that the symmetry leaves."""
        return 0.0, self.symmetry.value * self.value("period", point)

    def energy(self, point: Point) -> float:
        """The conserved quantity; raises ValueError where the model declares none."""
        return self.value("S", point) * self.coordinates.energy(point.problem, point.z)

    def frequency(self, orbit: Orbit) -> float:
        return orbit.point.Omega

    def S_of(self, orbit: Orbit) -> float:
        return orbit.value("S")

    def free_error(self, point: Point) -> float:
        return point.error.Omega / point.Omega

    def times(self, point: Point) -> Array:
        """Times of the phases at which the equations are solved."""
        return np.asarray(point.problem.phases() / point.Omega)

    def states(self, point: Point) -> Array:
        """Displacements at `times` and `output_sites`, shape (time, site)."""
        return self.states_at(point, point.problem.phases(), self.output_sites)

    def states_at(self, point: Point, theta: Array, sites: Indices | None) -> Array:
        """Displacements at phases, shape (len(theta), sites)."""
        return np.asarray(self._scale(point) * self.positions(point, theta, sites))

    @of_last_points
    def _scale(self, point: Point) -> float:
        """sqrt(S) with the sign that makes the largest displacement at t = 0 positive; the site can change in a family.

        Of sites that tie, as in a reciprocal chain, the last one decides; an orbit whose model is not odd has no image
        of the other sign. The corrector's residual of the normalisation is divided out, so that the amplitude is
        sqrt(S) to round-off.
        """
        coordinates, S = self.coordinates, self.value("S", point)
        start = coordinates.scale * point.problem.sample(point.z, np.zeros(1))[0]
        if coordinates.scaled.half_period is None:
            return float(np.sqrt(S) / coordinates.amplitude(start))
        tied = np.flatnonzero(np.abs(start) >= (1.0 - TIE_RTOL) * np.max(np.abs(start)))
        return float(np.sign(start[tied[-1]]) * np.sqrt(S) / coordinates.amplitude(start))

    def positions(self, point: Point, theta: Array, sites: Indices | None = None) -> Array:
        """Positions over sqrt(S) at phases theta, shape (len(theta), sites)."""
        return self.coordinates.displacements(point.problem, point.z, theta, sites)

    def log_displacements(self, point: Point, sites: ArrayLike | None) -> tuple[Array, Array]:
        """Natural logarithms of |y_n(0)|, and signs, also far below the smallest double."""
        z, smallest = with_small_components(self.point_solver, point)
        coordinates = self.coordinates
        solved = coordinates.log_solved(point, z, smallest)
        logs, signs = coordinates.log_displacements(point, solved, site_numbers(sites))
        return logs + np.log(abs(self._scale(point))), signs * np.sign(self._scale(point))
