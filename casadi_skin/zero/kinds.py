"""The kinds of special points, of codimension one on branches, of codimension two on curves of these: one row each.

A stretch of a branch on which something may be missing: what is not resolved is named.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from casadi_skin.zero.settings import End

FOLD, HOPF, BRANCH_POINT, DOUBLING, TORUS = "fold", "hopf", "branch point", "period doubling", "torus"
CROSSING_KINDS = BRANCH_POINT, DOUBLING, TORUS  # of a multiplier at 1, at -1, and of a pair
HOMOCLINIC, HETEROCLINIC = "homoclinic", "heteroclinic"
BOUND = "bound"  # on a state or a free parameter, which a branch comes to
EDGE = "edge of a tongue"  # of instability of a family
KREIN = "krein collision"

CUSP, TAKENS, ZERO_HOPF = "cusp", "bogdanov-takens", "zero-hopf"
BAUTIN, HOPF_HOPF = "generalized hopf", "hopf-hopf"
DEGENERATE_PITCHFORK, DEGENERATE_TRANSCRITICAL = "degenerate pitchfork", "degenerate transcritical"
DOUBLE = "double branch point"


@dataclass(frozen=True)
class CurveKind:
    """Names of the points that a curve of special points of one kind may meet.

    Attributes:
        another: where another eigenvalue is zero or multiplier 1, where one is -1, where one more pair is critical.
        degenerate: where the coefficient of the normal form vanishes; empty where there is no such coefficient.
        ends: points at which the curve ends.
        meetings: points at which the critical pair meets itself or others by the value of kappa (see `augmented`).
    """

    another: tuple[str, str, str]
    degenerate: str = ""
    ends: Mapping[str, End] = field(default_factory=dict)
    meetings: Mapping[float, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Kind:
    """What is known of the special points of a kind, of those of codimension two and of zeros of monitors a mark alone.

    Attributes:
        mark: their symbol in pictures and its filling: those of the field, as far as there are any.
        line: words and dashes of curves of them in pictures.
        changes: by which they may change the number of unstable eigenvalues of equilibria.
        shape: of G in the augmented problem (see `augmented`): numbers of left and of right null vectors.
        angle: of the critical multipliers; None of pairs, which have any.
        turns: of the orbits that leave them; 0 where none do.
        sides: halves of the branch that leaves them that differ from each other; empty where none is followed.
        of_equilibria, of_orbits: what curves of them in two parameters meet; None where they are none of these.
    """

    mark: tuple[str, str] = ("d", "0.8")
    line: tuple[str, Any] = ("", "-")
    changes: tuple[int, ...] = (0,)
    shape: tuple[int, int] = (1, 1)
    angle: float | None = 0.0
    turns: int = 0
    sides: tuple[int, ...] = ()
    of_equilibria: CurveKind | None = None
    of_orbits: CurveKind | None = None

    @property
    def has_coefficient(self) -> bool:
        """Whether the normal form has a coefficient, which may vanish."""
        return any(curve is not None and curve.degenerate for curve in (self.of_equilibria, self.of_orbits))


DASHED, DOTTED = (0, (4.0, 1.4)), (0, (1.0, 1.2))
KINDS: Mapping[str, Kind] = {
    FOLD: Kind(
        ("D", "0.6"), ("folds", "-"), changes=(1,),
        of_equilibria=CurveKind((TAKENS, "", ZERO_HOPF), CUSP),
        of_orbits=CurveKind(("1:1 resonance", "fold-flip", "fold-torus"), "cusp of cycles", {BAUTIN: End.BAUTIN}),
    ),
    HOPF: Kind(
        ("s", "black"), ("Hopf points", DASHED), changes=(2,), shape=(2, 1), angle=None, sides=(1,),
        of_equilibria=CurveKind((ZERO_HOPF, "", HOPF_HOPF), BAUTIN, {TAKENS: End.TAKENS}, {0.0: TAKENS}),
    ),
    DOUBLING: Kind(
        ("^", "0.6"), ("period doublings", DASHED), angle=np.pi, turns=2, sides=(1,),
        of_orbits=CurveKind(("fold-flip", "1:2 resonance", "flip-torus"), "generalized period doubling"),
    ),
    TORUS: Kind(
        ("h", "0.6"), ("tori", DOTTED), shape=(2, 1), angle=None,
        of_orbits=CurveKind(
            ("fold-torus", "flip-torus", "torus-torus"), "chenciner",
            {"1:1 resonance": End.RESONANCE_ONE, "1:2 resonance": End.RESONANCE_TWO, HOPF_HOPF: End.HOPF_HOPF,
             ZERO_HOPF: End.ZERO_HOPF},
            {1.0: "1:1 resonance", -1.0: "1:2 resonance", -0.5: "1:3 resonance", 0.0: "1:4 resonance"},
        ),
    ),
    BRANCH_POINT: Kind(
        ("o", "white"), ("branch points", DOTTED), changes=(0, 1), shape=(1, 2), turns=1, sides=(1, -1),
        of_equilibria=CurveKind((TAKENS, "", ZERO_HOPF)),
        of_orbits=CurveKind(("1:1 resonance", "fold-flip", "fold-torus")),
    ),
    HOMOCLINIC: Kind(("X", "white")),
    HETEROCLINIC: Kind(("P", "white")),
    BOUND: Kind(("|", "black")),
    CUSP: Kind(("v", "black")),
    TAKENS: Kind(("o", "black")),
    ZERO_HOPF: Kind(("P", "black")),
    BAUTIN: Kind(("*", "black")),
    HOPF_HOPF: Kind(("X", "black")),
    DEGENERATE_PITCHFORK: Kind(("d", "white")),
    DEGENERATE_TRANSCRITICAL: Kind(("D", "white")),
    DOUBLE: Kind(("8", "black")),
    "cusp of cycles": Kind(("v", "white")),
    "generalized period doubling": Kind(("<", "white")),
    "chenciner": Kind((">", "white")),
    "1:1 resonance": Kind(("$1$", "black")),
    "1:2 resonance": Kind(("$2$", "black")),
    "1:3 resonance": Kind(("$3$", "black")),
    "1:4 resonance": Kind(("$4$", "black")),
    "fold-flip": Kind(("p", "white")),
    "fold-torus": Kind(("H", "white")),
    "flip-torus": Kind(("8", "white")),
    "torus-torus": Kind(("X", "white")),
}  # fmt: skip
KINDS_BY_TURNS = {kind.turns: word for word, kind in KINDS.items() if kind.turns}
EQUILIBRIUM_CURVES = {word: kind.of_equilibria for word, kind in KINDS.items() if kind.of_equilibria}
ORBIT_CURVES = {word: kind.of_orbits for word, kind in KINDS.items() if kind.of_orbits}


def kind_of(word: str) -> Kind:
    """What is known of special points by their word, which may be that of a monitor."""
    return KINDS.get(word, Kind())


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
