"""Edges of tongues of instability of a family, followed in a parameter of the model with S free.

At each value of the parameter the edge is extrapolated from those before it, an orbit is solved there from theirs, and
every change of stability on a short stretch of the family around it is found as on the whole family. The edge is the
one of the same kind on the same side of its tongue; where none is near enough to what was extrapolated, the step is
halved. So edges of real tongues and Krein collisions are followed alike, for any model whose families have stability.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np

from casadi_skin.bvp.problem import Array, Scalar, SingularError
from casadi_skin.continuation.points import ContinuationSettings, End, Point
from casadi_skin.critical_orbits.edges import EdgeCurve, EdgePoint
from casadi_skin.models.ode import OdeModel
from casadi_skin.orbits.family import Family
from casadi_skin.orbits.family_tongues import tongues_on
from casadi_skin.orbits.method import Targets
from casadi_skin.orbits.orbit import Orbit
from casadi_skin.stability.flow import FlowError
from casadi_skin.stability.tongues import StabilityDiagram, StabilityEdge

AGREE = 1e-6  # of S: within which the edge that a curve starts from is found again
FIRST = 0.02  # of the way: the first step
GROWTH = 1.8  # of a step whose edge was well extrapolated
WELL, BADLY = 1e-3, 1e-2  # of S: how far the edge may be from where it was extrapolated
WIDEST, NARROWEST = 0.02, 1e-5  # of S: half the stretch on which the edge is sought
AROUND = 8.0  # times the error of the last extrapolation: the same
APART = 0.3  # of the distance of another edge of the kind: how far the edge may be from the extrapolation
TURNED = 0.05  # change of mu in a step
SHORTEST = 1e-5  # of the way: a step
NEAREST = 4  # edges that the next one is extrapolated from


def edge_curve(
    orbit: Orbit, S: float, parameter: str, to: float, at: Sequence[float], settings: ContinuationSettings,
    until: Callable[[Any], bool] | None = None, progress: Callable[[Any], None] | None = None,
) -> EdgeCurve:  # fmt: skip
    """The edge of a tongue near S of a family, followed in a parameter (see `critical_orbits.curve.curve`).

    Raises ArithmeticError where the edge is not found again.
    """
    walk = _Walk(orbit, S, parameter, float(to), sorted({*map(float, at), float(to)}), settings)
    stopped = False
    for point in walk:
        if progress is not None:
            progress(point)
        stopped = until is not None and until(point)
        if stopped:
            break
    return EdgeCurve(parameter, tuple(walk.points), None if stopped else walk.end, "" if stopped else walk.detail)


class _Walk:
    """Iterates over the points of a curve of edges."""

    def __init__(
        self, orbit: Orbit, S: float, parameter: str, to: float, at: Sequence[float], settings: ContinuationSettings
    ) -> None:
        assert isinstance(orbit.space, Family)
        self._family, self._name, self._to, self._settings = orbit.space.whole, parameter, to, settings
        self._start = float(orbit.parameters[parameter])
        self._at = [value for value in at if (value - self._start) * (to - self._start) > 0.0]
        self.points = list[EdgePoint]()
        self.end: End | None = None
        self.detail = ""
        self._opens = False
        self._missed = WELL
        self._first = self._found(self._start, S, orbit.space.on_all_positions(orbit.point), None)

    def __iter__(self) -> Iterator[EdgePoint]:
        span = self._to - self._start
        yield self._kept(self._first)
        step = FIRST * span
        while len(self.points) < self._settings.max_points:
            here = self.points[-1].parameters[self._name]
            if here == self._to:
                self.end, self.detail = End.REACHED, ""
                return
            ahead = [value for value in self._at if (value - here) * span > 0.0]
            target = min(ahead, key=lambda value: abs(value - here))
            value = target if abs(target - here) <= 1.01 * abs(step) else here + step
            found = self._stepped(value)
            if found is None:
                step = 0.5 * (value - here)
                if abs(step) < SHORTEST * abs(span):
                    self.end = End.NO_STEP
                    return
                continue
            well = self._missed <= WELL * found.edge.S
            step = (GROWTH if well else 0.7) * max(abs(value - here), abs(step) if well else 0.0) * np.sign(span)
            step = float(np.clip(step, -self._settings.max_step * abs(span), self._settings.max_step * abs(span)))
            yield self._kept(found)
        self.end, self.detail = End.POINTS, f"{self._settings.max_points} points"

    def _kept(self, point: EdgePoint) -> EdgePoint:
        self.points.append(point)
        return point

    def _stepped(self, value: float) -> EdgePoint | None:
        """The edge at a value of the parameter; None, with `detail` set, where it is not found for certain."""
        S = float(self._extrapolated(value, [point.edge.S for point in self.points]))
        mu = float(self._extrapolated(value, [point.edge.mu for point in self.points]))
        last = self.points[-1]
        level = last.orbit.point.problem.resolution
        known: list[Array] = [
            point.orbit.point.z for point in self.points[-NEAREST:] if point.orbit.point.problem.resolution == level
        ]
        guess = replace(last.orbit.point, z=np.asarray(self._extrapolated(value, known)))
        try:
            return self._found(value, S, guess, mu)
        except (ArithmeticError, ValueError, RuntimeError, np.linalg.LinAlgError) as error:
            here = f"{self._name} = {last.parameters[self._name]:.8g}, S = {last.edge.S:.8g}, mu = {last.edge.mu:.6g}"
            self.detail = f"beyond {here}: {error}"
            return None

    def _extrapolated(self, value: float, known: Sequence[Any]) -> Any:
        """Value of the polynomial through the last points at a value of the parameter."""
        count = min(len(known), NEAREST)
        places = np.array([point.parameters[self._name] for point in self.points[-count:]])
        total = 0.0 * np.asarray(known[-1])
        for k, entry in enumerate(known[-count:]):
            others = np.delete(places, k)
            total = total + float(np.prod((value - others) / (places[k] - others))) * np.asarray(entry)
        return total

    def _found(self, value: float, S: float, guess: Point, mu: float | None) -> EdgePoint:
        """The edge near S at a value of the parameter; raises ArithmeticError where none is found for certain."""
        if not S > 0.0:
            raise ArithmeticError("S comes to 0")
        family = self._at_value(value, S)
        half = S * float(np.clip(AROUND * self._missed, NARROWEST, WIDEST))
        center = _orbit_at(family, S, guess)
        ends = [_beside(family, center, S + side * half) for side in (-1.0, 1.0)]
        diagram = tongues_on(family, [ends[0], center, ends[1]])
        if diagram.unresolved:
            raise FlowError(diagram.unresolved[0].reason)
        edge = self._nearest(diagram, S, mu)
        self._missed = abs(edge.S - S) / S if mu is not None else WELL
        self._opens = _opens(diagram, edge)
        if abs(edge.S - S) > half:
            raise ArithmeticError("the edge is farther from where it is expected than the step allows")
        point = _orbit_at(family, edge.S, _beside(family, center, edge.S))
        values = {**family.parameters(point), "S": edge.S}
        return EdgePoint(Orbit(family, point), edge, values)

    def _nearest(self, diagram: StabilityDiagram, S: float, mu: float | None) -> StabilityEdge:
        """The edge that a curve goes on with; raises ArithmeticError where there is none, or it may be another one."""
        edges = [*diagram.changes, *diagram.further]
        if mu is None:
            nearest = min(edges, key=lambda edge: abs(edge.S - S), default=None)
            if nearest is None or abs(nearest.S - S) > AGREE * S:
                raise ArithmeticError("the edge is not found again")
            return nearest
        last = self.points[-1].edge
        alike = [e for e in edges if e.kind == last.kind and abs(e.mu - mu) <= TURNED]
        same = [e for e in alike if _opens(diagram, e) == self._opens]
        if not same:
            raise ArithmeticError("the edge is not found: its tongue closes, meets another one, or passes S too fast")
        nearest = min(same, key=lambda edge: abs(edge.S - S))
        others = [abs(edge.S - nearest.S) for edge in same if edge is not nearest]
        if abs(nearest.S - S) > min([BADLY * S, *(APART * other for other in others)]):
            raise ArithmeticError("the edge cannot be distinguished from another one")
        return nearest

    def _at_value(self, value: float, S: float) -> Family:
        """The family at a value of the parameter, to somewhat beyond S."""
        request, name = self._family.request, self._name
        changed: dict[str, Any] = {"targets": Targets(), "amplitude_max": 1.5 * S}
        if isinstance(request.model, OdeModel):
            changed["parameters"] = {**self._family.coordinates.parameters, name: value}
        else:
            model: Any = request.model
            changed["model"] = replace(model, **{name: value})
        return Family(replace(request, **changed))


def _opens(diagram: StabilityDiagram, edge: StabilityEdge) -> bool:
    """Whether an edge is the one at which its tongue starts, in the order of S."""
    return diagram.tongues[edge.tongue].start.coordinate == edge.place.coordinate


def parameters_of(family: Family) -> tuple[str, ...]:
    """Names of the parameters of a family's model in which its edges can be followed."""
    model, names = family.request.model, tuple(family.coordinates.parameters)
    if isinstance(model, OdeModel):
        return names
    known: list[str] = [f.name for f in fields(model)] if is_dataclass(model) else []
    return tuple(name for name in names if name in known)


def _orbit_at(family: Family, S: float, guess: Point) -> Point:
    """The orbit at S near a guess from a family beside; raises ArithmeticError where none is found."""
    problem = family.levels.problem(guess.problem.resolution)
    value, index = family.coordinates.parameter_of(S), problem.parameter_index
    z = guess.z.copy()
    z[index] = value
    row, solver = problem.parameter_row(), family.point_solver
    correction = solver.correct(problem, z, row, value, 1.0)
    if correction is None:
        raise ArithmeticError(solver.failure)
    correction.z[index] = value
    try:
        found = solver.refined(problem, correction, row, Scalar.PARAMETER)
    except SingularError as error:
        raise ArithmeticError(str(error)) from error
    if found is None:
        raise ArithmeticError("no level of resolution is fine enough")
    return found


def _beside(family: Family, point: Point, S: float) -> Point:
    """A guess at another S along the tangent of a point."""
    index = point.problem.parameter_index
    moved = (family.coordinates.parameter_of(S) - point.parameter) / point.tangent[index]
    return replace(point, z=point.z + moved * point.tangent, better=None)
