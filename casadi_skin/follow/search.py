"""The search for special points on a stretch of a branch, which is divided until each part is resolved."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Generic, TypeVar

import numpy as np

from casadi_skin.follow.sample import Sample
from casadi_skin.follow.stretch import WITHIN, Signs, Stretch
from casadi_skin.zero.settings import Point
from casadi_skin.zero.unresolved import Unresolved

DEEPEST = 20  # divisions of a stretch between two points of the continuation
SHORTEST = 1e-11  # of a step: shorter parts are not divided
MOST = 400  # parts that it is divided into
PLACES = (WITHIN, 0.3, 0.7)  # of a stretch, where one point after the other is tried


Event = TypeVar("Event")


class Search(ABC, Generic[Event]):
    """The search on one stretch of the continuation; `parts` counts the parts that it has been divided into.

    `deepest` is how often a part may be divided, `most_parts` how many there may be.
    """

    deepest, most_parts = DEEPEST, MOST

    def __init__(self, signs: Signs) -> None:
        self.signs, self.parts = signs, 0

    @abstractmethod
    def sample(self, point: Point) -> Sample:
        """The sample at a point."""

    @abstractmethod
    def along(self, before: Point, after: Point, fraction: float) -> Point | None:
        """The point at a fraction of the way between two points; None where it is not found."""

    def passes(self, ends: Stretch) -> bool:
        """Whether a part has no special points by its ends alone."""
        return False

    @abstractmethod
    def found(self, stretch: Stretch, depth: int, last: bool) -> Sequence[Event] | None:
        """Special points on a resolved part, in order; None where it has to be divided, unless it is the last."""

    def is_clear(self, point: Point) -> bool:
        """Whether every quantity has its sign at a point, where a stretch may be divided."""
        return True

    def suspected(self, stretch: Stretch) -> float | None:
        """The place at which a stretch is best divided; None where any will do."""
        return stretch.dip()

    @abstractmethod
    def unresolved(self, stretch: Stretch) -> Iterator[Event | Unresolved]:
        """What is known of a part that can be divided no further, and its record."""

    def between(self, before: Point, after: Point, depth: int = 0) -> Iterator[Event | Unresolved]:
        """Special points between two points in order, and the parts that are not resolved."""
        self.parts += 1
        if self.passes(Stretch.of((self.sample(before), self.sample(after)), self.signs)):
            return
        tried = (self.along(before, after, place) for place in PLACES)
        middle = next((point for point in tried if point is not None), None)
        points = (before, after) if middle is None else (before, middle, after)
        stretch = Stretch.of(tuple(self.sample(point) for point in points), self.signs)
        last = depth >= self.deepest or self.parts > self.most_parts or stretch.length <= SHORTEST
        found = self.found(stretch, depth, last or middle is None)
        if found is not None:
            yield from found
            return
        if last or middle is None:
            yield from self.unresolved(stretch)
            return
        divided = self._dividing(before, middle, after, self.suspected(stretch))
        yield from self.between(before, divided, depth + 1)
        yield from self.between(divided, after, depth + 1)

    def _dividing(self, before: Point, middle: Point, after: Point, dip: float | None) -> Point:
        """The point at which a stretch is divided."""
        for place in (dip, WITHIN, *PLACES[1:]):
            point = None if place is None else middle if place == WITHIN else self.along(before, after, place)
            if point is not None and _apart(before, point, after) and self.is_clear(point):
                return point
        return middle


def _apart(*points: Point) -> bool:
    """Whether neighbouring points are not the same but for rounding."""
    return all(float(np.max(np.abs(one.z - other.z))) > SHORTEST for one, other in pairwise(points))
