"""Edges of tongues of instability of a family, followed in a parameter of the model with S free.

At each value of the parameter the edge is extrapolated from those before it, an orbit is solved there from theirs, and
every change of stability on a short stretch of the family around it is found as on the whole family. The edge is the
one of the same kind on the same side of its tongue; where none is near enough to what was extrapolated, the step is
halved. So edges of real tongues and Krein collisions are followed alike, for any model whose families have stability.
Where the parameter folds both edges of a tongue meet: the curve goes around (see `edge_fold`) and back along the other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, cast

import numpy as np

from casadi_skin.follow.family import Family
from casadi_skin.follow.family_tongues import tongues_on
from casadi_skin.follow.orbit import Orbit
from casadi_skin.model.result import Result
from casadi_skin.points.edge_fold import Start, Turn, turn
from casadi_skin.points.edge_orbits import Orbits, beside, family_at, orbit_at, orbit_of_edge
from casadi_skin.stability.stepping import FlowError
from casadi_skin.stability.tongues.diagram import StabilityDiagram, StabilityEdge
from casadi_skin.zero.problem import Array
from casadi_skin.zero.settings import ContinuationSettings, End, Point

# The edge of a tongue of instability in a second parameter, as a result -----------------------------------------------


@dataclass(frozen=True, eq=False)
class EdgePoint:
    """A point of a curve of edges.

    Attributes:
        orbit: of the family, at the edge.
        edge: its kind and place, with the error of S.
        parameters: of the model by name, and S.
        parameter_error: estimated error of the parameter that is followed, where that folds; 0 elsewhere.
    """

    orbit: Orbit
    edge: StabilityEdge
    parameters: Mapping[str, float]
    parameter_error: float = 0.0


@dataclass(frozen=True, eq=False)
class EdgeCurve(Result):
    """The edge of a tongue of a family in a second parameter.

    Attributes:
        parameter: that is followed.
        points: in order.
        end: reason for its end; None where it was stopped.
        detail: details of the reason.
        folded: numbers of the points at which the parameter folds, from 0.
    """

    parameter: str
    points: tuple[EdgePoint, ...]
    end: End | None
    detail: str = ""
    folded: tuple[int, ...] = ()

    def __len__(self) -> int:
        return len(self.points)

    def __iter__(self) -> Iterator[EdgePoint]:
        return iter(self.points)

    def __getitem__(self, name: str) -> Array:
        """Values of a parameter, or of S, along the curve, shape (points,)."""
        return np.array([point.parameters[name] for point in self.points])

    def __repr__(self) -> str:
        values = self[self.parameter]
        return (
            f"<EdgeCurve: {len(self)} points, {self.parameter} from {values[0]:.6g} to {values[-1]:.6g}; {self.reason}>"
        )

    @property
    def kind(self) -> str:
        """Multipliers that leave the unit circle: "real" through 1 or -1, "complex" where two meet.

        Where the family crosses one of an m-th of its period "1:m resonance" of the shorter orbit, which points hold.
        """
        return self.points[0].edge.kind

    @property
    def solutions(self) -> tuple[Orbit, ...]:
        """The orbits at the edge."""
        return tuple(point.orbit for point in self.points)

    @property
    def folds(self) -> tuple[EdgePoint, ...]:
        """Points at which the parameter folds: there both edges of a tongue, or of a window between two, meet."""
        return tuple(self.points[number] for number in self.folded)

    @property
    def S(self) -> Array:
        """Amplitudes, shape (points,)."""
        return self["S"]

    @property
    def errors(self) -> Array:
        """Estimated errors of S, shape (points,)."""
        return np.array([point.edge.error for point in self.points])

    @property
    def complete(self) -> bool:
        """Whether the curve reached its requested end, came back beyond a fold or closed, or was stopped."""
        return self.end in (None, End.REACHED, End.AWAY, End.CLOSED)

    @property
    def reason(self) -> str:
        """The end of the curve, in a sentence."""
        words = "stopped where the condition holds" if self.end is None else str(self.end.value)
        return f"{words}: {self.detail}" if self.detail else words


AGREE = 1e-6  # of S: within which the edge that a curve starts from is found again
FIRST = 0.02  # of the way: the first step
GROWTH = 1.8  # of a step whose edge was well extrapolated
WELL, BADLY = 1e-3, 1e-2  # of S: how far the edge may be from where it was extrapolated
WIDEST, NARROWEST = 0.02, 1e-5  # of S: half the stretch on which the edge is sought
ASIDE, UNEVEN = 0.4, 0.8  # of that half: where an orbit and an end are, as equations may be singular at an edge
AROUND = 8.0  # times the error of the last extrapolation: the same
APART = 0.3  # of the distance of another edge of the kind: how far the edge may be from the extrapolation
TURNED = 0.05  # change of mu in a step
SHORTEST = 1e-5  # of the way: a step
NEAR_FOLD = 0.5  # of the distance to a fold: a step that is not taken there goes around it
FORESEEN = 10.0  # times the way of the last edges: how far ahead a fold is foreseen
FINE, ROUGH = 1e-10, 1e-8  # tolerances of multipliers around a fold
NEAREST = 4  # edges that the next one is extrapolated from


def edge_curve(
    orbit: Orbit, S: float, parameter: str, to: float, at: Sequence[float], settings: ContinuationSettings,
    until: Callable[[Any], bool] | None, progress: Callable[[Any], None] | None, back_to: float | None,
    kind: type[EdgeWalk],
) -> EdgeCurve:  # fmt: skip
    """The edge of a tongue near S of a family, followed in a parameter (see `critical_orbits.curve.curve`).

    Raises ArithmeticError and ValueError where the edge is not found again.
    """
    walk = kind(orbit, S, parameter, float(to), at, settings, back_to)
    stopped = False
    for point in walk:
        if progress is not None:
            progress(point)
        stopped = until is not None and until(point)
        if stopped:
            break
    end, detail = (None, "") if stopped else (walk.end, walk.detail)
    return EdgeCurve(parameter, tuple(walk.points), end, detail, tuple(walk.folds))


class EdgeWalk:
    """Iterates over the points of a curve of edges; `folds` are the numbers of those at which the parameter folds."""

    def __init__(
        self, orbit: Orbit, S: float, parameter: str, to: float, at: Sequence[float], settings: ContinuationSettings,
        back_to: float | None,
    ) -> None:  # fmt: skip
        assert isinstance(orbit.space, Family)
        self._family, self._name, self._settings = orbit.space.whole, parameter, settings
        start = float(orbit.parameters[parameter])
        self._goal, self._other_goal = to, start if back_to is None else back_to
        self._to, self._span = to, to - start
        self._at = sorted(float(value) for value in at)
        self.points, self.folds = list[EdgePoint](), list[int]()
        self._trail = list[EdgePoint]()  # those since the last fold
        self.end: End | None = None
        self.detail = ""
        self._opens = False
        self._missed = WELL
        for value in (to, self._other_goal):
            self.at_value(value, S)  # refused where the model has no such value
        self._first = self._found(start, S, self._guess(orbit), None)

    def __iter__(self) -> Iterator[EdgePoint]:
        yield self._kept(self._first)
        step = FIRST * self._span
        while len(self.points) < self._settings.max_points:
            here = self.points[-1].parameters[self._name]
            if here == self._goal:
                self._ended()
                return
            way = np.sign(self._goal - here)
            ahead = [value for value in (*self._at, self._goal) if (value - here) * way > 0.0]
            target = min(ahead, key=lambda value: abs(value - here))
            value = target if abs(target - here) <= 1.01 * abs(step) else here + step
            found = self._stepped(value)
            if found is None:
                around = self._around_fold(value)
                if around:
                    step = 0.5 * (around[-1].parameters[self._name] - around[-2].parameters[self._name])
                    yield from around
                    continue
                step = 0.5 * (value - here)
                if abs(step) < SHORTEST * abs(self._span):
                    self.end = End.NO_STEP
                    return
                continue
            well = self._missed <= WELL * found.edge.S
            longest = self._settings.max_step * abs(self._span)
            step = (GROWTH if well else 0.7) * max(abs(value - here), abs(step) if well else 0.0)
            step = float(way * min(step, longest))
            yield self._kept(found)
        self.end, self.detail = End.POINTS, f"{self._settings.max_points} points"

    def _ended(self) -> None:
        """Set the end of a curve that has come to its goal."""
        first, last = self.points[0], self.points[-1]
        closed = len(self.points) > 1 and first.parameters[self._name] == last.parameters[self._name]
        if self._goal == self._to:
            self.end = End.REACHED
        elif closed and abs(last.edge.S - first.edge.S) <= AGREE * first.edge.S:
            self.end = End.CLOSED
        else:
            self.end = End.AWAY
        self.detail = ""

    # Around folds -----------------------------------------------------------------------------------------------------

    def _around_fold(self, value: float) -> list[EdgePoint]:
        """A fold before a value of the parameter and points beyond it, which are kept; none where there is no fold."""
        away = self._fold_ahead()
        if away is None or abs(value - self.points[-1].parameters[self._name]) < NEAR_FOLD * abs(away[1]):
            return []
        last, count = self.points[-1], len(self.points)
        start = Start(last.edge.kind, last.edge.S, last.edge.mu, last.parameters[self._name], *away)
        try:
            orbits = Orbits(partial(self.at_value, tolerance=FINE), last.orbit.point)
            rougher = replace(orbits, family_at=partial(self.at_value, tolerance=ROUGH), families={})
            found = turn(orbits.multipliers, rougher.multipliers, start)
            self._opens = not self._opens
            self._kept(self._at_fold(found, orbits.near(found.S, found.value)))
            self.folds.append(count)
            for S, mu, there in found.beyond:
                self._missed = WELL
                self._kept(self._found(there, S, orbits.near(S, there), mu))
            self._missed = WELL
        except (ArithmeticError, ValueError, RuntimeError) as error:
            if len(self.points) > count:
                del self.points[count:], self.folds[-1:]
                self._opens = not self._opens
            self.detail = f"around a fold near {self._name} = {start.value:.8g}, S = {start.S:.8g}: {error}"
            return []
        self._trail = self.points[count + 1 :]
        self._goal, self._other_goal = self._other_goal, self._goal
        return self.points[count:]

    def _fold_ahead(self) -> tuple[float, float] | None:
        """Differences of S and of the parameter to a fold, by the parabola through the last edges; None without one."""
        if len(self._trail) < 3:
            return None
        S = np.array([point.edge.S for point in self._trail[-3:]])
        values = np.array([point.parameters[self._name] for point in self._trail[-3:]])
        curvature, slope, _ = np.polyfit(S - S[-1], values - values[-1], 2)
        with np.errstate(all="ignore"):
            S_away, away = -0.5 * slope / curvature, -0.25 * slope**2 / curvature
        onwards = S_away * (S[-1] - S[-2]) > 0.0 and away * (values[-1] - values[-2]) > 0.0
        near = abs(away) < FORESEEN * abs(values[-1] - values[0])
        return (float(S_away), float(away)) if onwards and near else None

    def _at_fold(self, found: Turn, guess: Point) -> EdgePoint:
        """The fold as a point of the curve."""
        last, family = self.points[-1], self.at_value(found.value, found.S)
        orbit = Orbit(family, orbit_at(family, found.S, guess))
        place = replace(last.edge.place, coordinate_error=0.0, S=found.S, S_error=found.S_error, Omega=orbit.Omega)
        edge = replace(last.edge, place=place, mu=found.mu, width=0.0)
        return EdgePoint(orbit, edge, {**orbit.parameters, "S": found.S}, found.error)

    def _guess(self, orbit: Orbit) -> Point:
        """The orbit that a curve starts from."""
        return cast(Family, orbit.space).on_all_positions(orbit.point)

    # Points -----------------------------------------------------------------------------------------------------------

    def _kept(self, point: EdgePoint) -> EdgePoint:
        self.points.append(point)
        self._trail.append(point)
        return point

    def _stepped(self, value: float) -> EdgePoint | None:
        """The edge at a value of the parameter; None, with `detail` set, where it is not found for certain."""
        S = float(self._extrapolated(value, [point.edge.S for point in self._trail]))
        mu = float(self._extrapolated(value, [point.edge.mu for point in self._trail]))
        last = self.points[-1]
        level = last.orbit.point.problem.resolution
        known: list[Array] = [
            point.orbit.point.z for point in self._trail[-NEAREST:] if point.orbit.point.problem.resolution == level
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
        places = np.array([point.parameters[self._name] for point in self._trail[-count:]])
        total = 0.0 * np.asarray(known[-1])
        for k, entry in enumerate(known[-count:]):
            others = np.delete(places, k)
            total = total + float(np.prod((value - others) / (places[k] - others))) * np.asarray(entry)
        return total

    def _found(self, value: float, S: float, guess: Point, mu: float | None) -> EdgePoint:
        """The edge near S at a value of the parameter; raises ArithmeticError where none is found for certain."""
        if not S > 0.0:
            raise ArithmeticError("S comes to 0")
        family = self.at_value(value, S)
        half = S * float(np.clip(AROUND * self._missed, NARROWEST, WIDEST))
        center = orbit_at(family, S + ASIDE * half, guess)
        ends = [beside(family, center, S + side * half) for side in (-1.0, UNEVEN)]
        diagram = tongues_on(family, [ends[0], center, ends[1]])
        if diagram.unresolved:
            raise FlowError(diagram.unresolved[0].reason)
        edge = self._nearest(diagram, S, mu)
        self._missed = abs(edge.S - S) / S if mu is not None else WELL
        self._opens = _opens(diagram, edge)
        if abs(edge.S - S) > half:
            raise ArithmeticError("the edge is farther from where it is expected than the step allows")
        point = orbit_of_edge(family, edge.S, center)
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

    def at_value(self, value: float, S: float, tolerance: float | None = None) -> Family:
        """The family at a value of the parameter, to somewhat beyond S."""
        return family_at(self._family, self._name, value, S, tolerance)


def _opens(diagram: StabilityDiagram, edge: StabilityEdge) -> bool:
    """Whether an edge is the one at which its tongue starts, in the order of S."""
    start, place = diagram.tongues[edge.tongue].start, edge.place
    return abs(start.coordinate - place.coordinate) <= start.coordinate_error + place.coordinate_error
