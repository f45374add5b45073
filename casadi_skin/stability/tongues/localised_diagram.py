"""Changes of localised multipliers along a branch of orbits at the edge of an endless linear medium, as results."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from casadi_skin.follow.unresolved import Unresolved, count_in_words
from casadi_skin.model.result import Result
from casadi_skin.stability.tongues.diagram import Meeting

REAL, COMPLEX, BAND_EDGE, RESONANCE, OVERLAP = "real", "complex", "band edge", "resonance", "overlap"


@dataclass(frozen=True)
class LocalisedChange(Meeting):
    """A place where the localised multipliers of an orbit change, or the arcs of its continuous spectrum do.

    `kind` is "real" where a pair meets at 1 (`mu` is -1 or 0); "complex" where two of opposite signatures collide, on
    the circle (a Krein collision) or on the real axis; "band edge" where one becomes localised, or ceases to be, as it
    meets the end of an arc; "resonance" where complex ones leave an arc under which waves of both signatures are, or
    come back to it; "overlap" where arcs of opposite signature begin to overlap, or end. `signatures` are those of the
    multipliers or waves that meet, none where they meet at 1. `off_before` and `off_after` count localised multipliers
    outside the circle.
    """

    off_before: int
    off_after: int

    @property
    def stable_before(self) -> bool:
        """Whether no localised multiplier is off the circle before, in order of the branch."""
        return self.off_before == 0

    @property
    def stable_after(self) -> bool:
        """Whether no localised multiplier is off the circle behind it."""
        return self.off_after == 0

    @property
    def multiplier(self) -> complex:
        """The multiplier over the period, that in the upper half plane or on the real axis."""
        root = np.sqrt(self.mu + 0j) + np.sqrt(1.0 + self.mu + 0j)
        value = complex(root**4)
        return value if value.imag >= 0.0 else value.conjugate()


@dataclass(frozen=True, eq=False)
class LocalisedDiagram(Result):
    """Every change of localised multipliers along a branch of orbits at the edge of an endless linear medium.

    `changes` are those between stable and unstable, `further` the others, each in order along the branch; `unresolved`
    are stretches on which some may be missing. `samples` counts the orbits that were computed.
    """

    changes: tuple[LocalisedChange, ...]
    further: tuple[LocalisedChange, ...]
    unresolved: tuple[Unresolved, ...]
    samples: int

    def __repr__(self) -> str:
        left = f", {len(self.unresolved)} stretches unresolved" if self.unresolved else ""
        changes, further = (count_in_words(len(each), self.unresolved) for each in (self.changes, self.further))
        return f"<LocalisedDiagram: {changes} changes of stability, {further} further{left}>"

    @property
    def complete(self) -> bool:
        """Whether no stretch of the branch is unresolved."""
        return not self.unresolved

    @property
    def all(self) -> tuple[LocalisedChange, ...]:
        """`changes` and `further` in order along the branch."""
        return tuple(sorted((*self.changes, *self.further), key=lambda change: change.place.coordinate))

    def first_instability(self) -> LocalisedChange | None:
        """The first change from stable to unstable; None where there is none."""
        return next((change for change in self.changes if change.stable_before), None)
