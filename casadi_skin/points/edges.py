"""The edge of a tongue of instability in a second parameter, as a result."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from casadi_skin.follow.orbit import Orbit
from casadi_skin.follow.settings import End
from casadi_skin.model.result import Result
from casadi_skin.stability.tongues.diagram import StabilityEdge
from casadi_skin.zero.problem import Array


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
