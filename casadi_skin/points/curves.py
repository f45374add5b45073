"""Folds, period doublings and tori of orbits followed in a second parameter, by the problems that they solve."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, cast

import numpy as np

from casadi_skin.follow import rest_space as of_equilibria
from casadi_skin.follow.boundary_space import BoundarySpace, hopf_near
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.codimension_two import OrbitCurveSearch, kappa, special_on_curve
from casadi_skin.follow.follow import BranchRun
from casadi_skin.follow.normal_forms import critical_angle, terms_of
from casadi_skin.follow.rest_space import find_equilibrium
from casadi_skin.follow.solution import Solution, following_settings
from casadi_skin.follow.space import FAMILY, ORBITS, BoundaryError, of_last_points
from casadi_skin.follow.special_points import (
    Located,
    SpecialPoint,
    check_second,
    ending,
    locate,
    special_solutions,
)
from casadi_skin.model.arguments import check_name
from casadi_skin.model.result import in_turn
from casadi_skin.points.edges import EdgeCurve, edge_curve, parameters_of
from casadi_skin.stability.result import Floquet
from casadi_skin.zero.augmented import SingularProblem
from casadi_skin.zero.kinds import EDGE, FOLD, HOPF, KINDS, ORBIT_CURVES, Unresolved
from casadi_skin.zero.linearised import Linearised
from casadi_skin.zero.settings import ContinuationSettings, End, ErrorEstimate, Point
from casadi_skin.zero.stated_problem import PERIOD, Closure


@dataclass(frozen=True, eq=False)
class OrbitCurveSpace(BoundarySpace):
    """Special orbits of one kind in two parameters, of which one is followed and the other one free.

    Attributes:
        kind: "fold", "period doubling", "torus" or "branch point".
        orbits: the space of the branch on which the first was found.
        repeats: whether solutions of a stated problem go on after its interval as they close, so that they have normal
            forms.
    """

    kind: str = FOLD
    orbits: BoundarySpace | None = None
    repeats: bool = False

    @property
    def stability_included(self) -> bool:
        """Where solutions have multipliers, which are needed for the special points."""
        return self.periodic is not None or self.repeats

    @cached_property
    def closure(self) -> Closure | None:
        """How conditions close the solutions themselves, without their linearisation."""
        return self.orbits.closure if self.repeats and self.orbits is not None else None

    @property
    def free(self) -> tuple[str, ...]:
        """The parameter that is solved for with the orbit, and those that every orbit has free."""
        assert self.singularity is not None
        return (self.singularity.first, *self.statement.free)

    def linearised(self, point: Point) -> Linearised:
        """The equations of the orbit of a point around it."""
        assert self.singularity is not None
        angle = KINDS[self.kind].angle
        angle = float(np.arccos(np.clip(kappa(point), -1.0, 1.0))) if angle is None else angle
        return Linearised(cast(SingularProblem, point.problem), point.z, self.statement, angle, self.singularity.turn)

    def special_between(self, before: Point, after: Point, gaps: list[Unresolved]) -> Iterator[Point]:
        """Points of codimension two on the stretch between two points, in order; `gaps` gets parts not resolved."""
        end = shrunk(self, before, after) if self.shrinks(before, after) else None
        yield from [end] if end is not None else special_on_curve(OrbitCurveSearch(self, before, after), gaps)

    def stop(self, point: Point) -> tuple[End | None, str]:
        """Beyond the resonances 1:1 and 1:2 there are no tori, and beyond amplitude zero the curve comes back."""
        end = ORBIT_CURVES[self.kind].ends.get(point.special)
        return (end, "") if end is not None else super().stop(point)

    def branch_space(
        self, solution: Solution, parameter: str, to: float, at: tuple[float, ...], settings: ContinuationSettings
    ) -> BoundarySpace:
        """The space of the orbits through one of these in one parameter."""
        assert self.orbits is not None
        point, count = solution.point, len(self.orbits.statement.free)
        first = replace(point, z=np.append(point.z[: point.problem.states + count], 0.0), special="")
        statement = self.orbits.statement.with_parameters(**solution.parameters)
        return replace(
            self.orbits, statement=statement, parameter=parameter, to=to, at=at, first=first, settings=settings,
            leaves=False,
        )  # fmt: skip

    @of_last_points
    def floquet(self, point: Point) -> Floquet:
        """Multipliers."""
        return self.floquets([point])[0]

    @of_last_points
    def coefficient(self, point: Point) -> float:
        """The coefficient of the normal form."""
        linear = self.linearised(point)
        return float(np.sum(terms_of(self.kind, linear, *linear.critical(self.kind))))


@in_turn
def curve(
    point: SpecialPoint,
    parameter: str,
    to: float,
    *,
    at: Sequence[float] = (),
    max_points: int = 500,
    max_step: float = 0.2,
    back_to: float | None = None,
    until: Callable[[Any], bool] | None = None,
    progress: Callable[[Any], None] | None = None,
) -> Branch | EdgeCurve:
    """A special point followed in a second parameter, with that in which it was found free.

    Arguments:
        point: a fold, a Hopf point or, where something keeps it, a branch point of equilibria; of orbits a fold, a
            period doubling, a torus or, where something keeps it, a branch point; of a family the edge of a tongue
            (`Branch.edge`), with S free.
        parameter: name of the second parameter.
        to: its value at which the curve ends.
        at, max_points, max_step, back_to, until, progress: as in `follow`.

    Returns:
        The curve as a branch, of edges as an `EdgeCurve`; its special points are those of codimension two: of
        equilibria "cusp", "bogdanov-takens", "zero-hopf", "generalized hopf", "hopf-hopf"; of branch points
        "degenerate pitchfork", "degenerate transcritical", "double branch point"; of orbits "cusp of cycles",
        "generalized period doubling", "chenciner", "1:1 resonance" to "1:4 resonance", "fold-flip", "fold-torus",
        "flip-torus", "torus-torus". It also ends where it comes back to the value that it started from, Hopf points at
        a Bogdanov-Takens point, tori at the resonances 1:1 and 1:2, and orbits where they shrink to an equilibrium.

    Raises:
        ValueError: an argument is out of range, or the point is of another kind.
        EquilibriumError, BoundaryError: the curve cannot be started.
    """
    options: dict[str, Any] = {"at": at, "max_points": max_points, "max_step": max_step, "back_to": back_to}
    if point.kind != EDGE:
        return BranchRun(curve_space(point, parameter, to, **options), until=until).to_end(progress)
    orbit = point.solution
    check_name("parameter", parameter, parameters_of(orbit.space))
    settings, S = following_settings(orbit, parameter, to, **options), point.parameters[point.parameter]
    return edge_curve(orbit, S, parameter, float(to), at, settings, until, progress, back_to)


def curve_space(point: SpecialPoint, parameter: str, to: float, **options: Any) -> Any:
    """The space of the curve of a special point in a second parameter; options are those of `curve`, checked here."""
    solution = point.solution
    if not (solution.space.has_ledger and point.kind in ORBIT_CURVES):
        if solution.space.connects in (FAMILY, ORBITS):
            raise ValueError(f"curve: given a {point.kind} of orbits; accepted: {', '.join(ORBIT_CURVES)} of a branch")
        return of_equilibria.curve_space(point, parameter, to, **options)
    check_second(point, parameter)
    settings = following_settings(solution, parameter, to, **options)
    orbits = solution.space
    located = locate(orbits, point.kind, solution.point, critical_angle(point.kind, solution))
    if located is None:
        why = "its extended equations are not solved"
        raise BoundaryError(f"{orbits.model.name}: the {point.kind} cannot be followed: {why}")
    unit = abs(orbits.to - orbits.statement.values[point.parameter])
    space = _space(orbits, located, unit, solution.parameters, parameter, to, options["at"], settings)
    if orbits.closure is not None:
        space = replace(space, repeats=orbits.closure.goes_on(solution.problem, solution.point.z))
    of_equilibria.check_kept(space, "no symmetry, and nothing else,")
    return space


def _space(
    orbits: BoundarySpace, located: Located, unit: float, parameters: Mapping[str, float], parameter: str,
    to: float, at: Sequence[float], settings: ContinuationSettings,
) -> OrbitCurveSpace:  # fmt: skip
    """The space of the curve through a located orbit, at the parameters of the branch that it was found on."""
    singularity = located.singularity
    held = {name: parameters[name] for name in orbits.statement.model.parameter_names}
    statement = orbits.statement.with_parameters(**{**held, singularity.first: located.value})
    special = special_solutions(singularity, orbits, statement, unit, parameter, float(to))
    given = {f.name: getattr(special, f.name) for f in fields(BoundarySpace) if f.init}
    given |= {"periodic": orbits.periodic, "at": tuple(map(float, at)), "first": located.point, "settings": settings}
    return OrbitCurveSpace(**given, kind=singularity.kind, orbits=orbits)


# The end of a curve of special orbits where the orbits shrink to an equilibrium --------------------------------------

HOPF_WAY_FRACTION = 0.5  # of the way of the second parameter: how far Hopf points are followed
END_DISTANCE_FRACTION = 0.1  # of it: how far from the smallest orbit the end may be


def shrunk(space: OrbitCurveSpace, before: Point, after: Point) -> Point | None:
    """The point of a curve of Hopf points at which the orbits have amplitude zero; None where none is found."""
    assert space.singularity is not None
    name, unit = space.singularity.first, float(space.sizes.scalars[len(space.statement.free)])
    begin, ends = space.statement.values[name], ORBIT_CURVES[space.kind].ends
    near = hopf_near(space, before, after, name, begin, begin + unit)
    if near is None or not ends:
        return None
    smaller, _, equilibria, born = near
    at = dict(equilibria.problem.named(born.resting))
    resting = find_equilibrium(space.model, equilibria.problem.state(born.resting), parameters=at)
    known = replace(resting.space, sizes=equilibria.sizes, parameter=name, to=at[name] + unit)  # one at zero has none
    resting = replace(resting, space=known)
    hopf = SpecialPoint(HOPF, name, at, born.error * unit, resting)
    start, span = hopf.parameters[space.parameter], space.to - space.statement.values[space.parameter]
    found = list[SpecialPoint]()
    for side in (1.0, -1.0):
        to = start + side * HOPF_WAY_FRACTION * span
        curve = BranchRun(curve_space(hopf, space.parameter, to, at=(), max_points=500, max_step=0.05)).to_end()
        found += [point for point in curve.special_points if point.kind in ends]
    close = [p for p in found if abs(p.parameters[space.parameter] - start) <= END_DISTANCE_FRACTION * abs(span)]
    if not close:
        return None
    end = min(close, key=lambda point: abs(point.parameters[space.parameter] - start))
    eigenvalues = end.solution.eigenvalues
    omega = eigenvalues[np.argmin(np.abs(eigenvalues - 2.0j * np.pi / space.parameters(smaller)[PERIOD]))].imag
    error = ErrorEstimate(end.solution.error, end.solution.error, parameter=end.error / abs(span))
    values, u = {**end.parameters, PERIOD: 2.0 * np.pi / float(omega)}, space.fraction(end.parameters[space.parameter])
    return ending(smaller, end.kind, end.solution.evaluate(0.0), values, u, error)
