"""Names of the kinds of special points: of codimension one on branches, of codimension two on curves of these.

A stretch of a branch on which something may be missing: what is not resolved is named.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

FOLD, HOPF, BRANCH_POINT, DOUBLING, TORUS = "fold", "hopf", "branch point", "period doubling", "torus"
HOMOCLINIC, HETEROCLINIC = "homoclinic", "heteroclinic"
BOUND = "bound"  # on a state or a free parameter, which a branch comes to
EDGE = "edge of a tongue"  # of instability of a family
KREIN = "krein collision"

CUSP, TAKENS, ZERO_HOPF = "cusp", "bogdanov-takens", "zero-hopf"
BAUTIN, HOPF_HOPF = "generalized hopf", "hopf-hopf"
DEGENERATE_PITCHFORK, DEGENERATE_TRANSCRITICAL = "degenerate pitchfork", "degenerate transcritical"
DOUBLE = "double branch point"


# A stretch of a branch on which something may be missing: what is not resolved is named ------------------------------

STABILITY = "changes of stability"


@dataclass(frozen=True)
class Unresolved:
    """A stretch of a branch on which special points or changes of stability may be missing.

    Attributes:
        start, end: values of the parameter at both ends, in the order of the branch.
        reason: why it is not resolved, in words.
        kind: what may be missing: "hopf", "fold" or another kind of special points, or "changes of stability".
        parameter: name of the parameter: S of a family.
        coordinates: places of both ends along a family.
    """

    start: float
    end: float
    reason: str
    kind: str = STABILITY
    parameter: str = "S"
    coordinates: tuple[float, ...] = ()

    def __str__(self) -> str:
        """One line."""
        where = f" to {self.end:.8g}" if self.end != self.start else ""
        return f"{self.kind} at {self.parameter} = {self.start:.8g}{where}: {self.reason}"

    @property
    def S_start(self) -> float:
        """S at the start of a stretch of a family."""
        return self.start

    @property
    def S_end(self) -> float:
        """S at the end of a stretch of a family."""
        return self.end

    @property
    def coordinate_start(self) -> float:
        """Place of the start along a family."""
        return self.coordinates[0]

    @property
    def coordinate_end(self) -> float:
        """Place of the end along a family."""
        return self.coordinates[1]


def count_in_words(count: int, unresolved: Collection[object]) -> str:
    """A count of what is found on a branch: the least that it can be where something is unresolved."""
    return f"at least {count}" if unresolved else str(count)
