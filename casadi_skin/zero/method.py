"""Numerical methods of orbits, and the places along a branch where they are wanted: frozen objects."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from casadi_skin.model import methods
from casadi_skin.model.arguments import number, numbers, short_repr, whole
from casadi_skin.model.methods import COLLOCATION_TABLES, SHOOTING, TRIGONOMETRIC
from casadi_skin.model.symmetry import SymmetryClass

TWO_PI = 2.0 * math.pi
TOLERANCES = (1e-13, 1e-2)
HIGHEST_DEGREE = 12
MOST_INTERVALS = 1500  # of a first mesh
STABILITY_SITES = (8, 2000)  # matrices of twice as many rows
MAX_POINTS = 2000  # of a family: ten times the need of those that do not wander from one resonance to the next
SAME = 1e-12  # relative difference of periods that are the same


@dataclass(frozen=True)
class Method:
    """The interchangeable methods by name, as in the table [method] of a scene; None leaves a choice open.

    Attributes:
        transcription: a name in `methods.TRANSCRIPTIONS`.
        degree: of the polynomials of gauss and radau.
        corrector: a name in `methods.CORRECTORS`.
        walker: a name in `methods.CONTINUATIONS`.
        flow: a name in `methods.FLOWS`, for orbits of a boundary-value problem in `methods.FULL_PERIOD_FLOWS`.
        tail: "eliminated" or "full": what becomes of the linear tail of a long chain.
        intervals: of the first mesh.
        symmetry: a part of the period larger than the symmetries of the model need.
        stability_sites: sites at the edge of a chain with an eliminated tail on whose motion stability is computed:
            localised multipliers. Left out, all sites, or as many as these need where they are too many.

    Raises ValueError for other values.
    """

    transcription: str | None = None
    degree: int | None = None
    corrector: str = "ipopt"
    walker: str | None = None
    flow: str | None = None
    tail: str | None = None
    intervals: int | None = None
    symmetry: SymmetryClass | None = None
    stability_sites: int | None = None

    def __post_init__(self) -> None:
        flows = (*methods.FLOWS, *(name for name in methods.FULL_PERIOD_FLOWS if name not in methods.FLOWS))
        for name, accepted in (
            ("transcription", tuple(methods.TRANSCRIPTIONS)),
            ("corrector", tuple(methods.CORRECTORS)),
            ("walker", tuple(methods.CONTINUATIONS)),
            ("flow", flows),
            ("tail", methods.TAILS),
        ):
            given = getattr(self, name)
            known = isinstance(given, str) and given in accepted
            if not known and not (given is None and name != "corrector"):
                raise ValueError(f"{name}: given {short_repr(given)}; accepted: {', '.join(accepted)}")
        if self.intervals is not None:
            whole("intervals", self.intervals, 1, MOST_INTERVALS)
        if not (self.symmetry is None or isinstance(self.symmetry, SymmetryClass)):
            raise TypeError(f"symmetry: given {short_repr(self.symmetry)}; accepted: a SymmetryClass")
        if self.stability_sites is not None:
            whole("stability_sites", self.stability_sites, *STABILITY_SITES)
        self._check_together()

    def _check_together(self) -> None:
        """Raises ValueError for two choices that exclude each other."""
        if self.degree is not None and self.transcription in (TRIGONOMETRIC, SHOOTING):
            accepted = f"with {' or '.join(COLLOCATION_TABLES)} only"
            raise ValueError(f"degree: given {short_repr(self.degree)}; accepted: {accepted}")
        if self.walker == "series" and self.transcription not in (None, TRIGONOMETRIC):
            raise ValueError(f'walker: given "series"; accepted with {self.transcription}: arclength')
        if self.stability_sites is not None and self.tail == "full":
            raise ValueError(f'stability_sites: given {self.stability_sites} with tail "full"; accepted: eliminated')
        if self.symmetry not in (None, SymmetryClass.QUARTER) and self.transcription == TRIGONOMETRIC:
            raise ValueError(f"symmetry: given {self.symmetry}; odd cosines live on a quarter of the period; use gauss")

    def check_degree(self, lowest: int) -> None:
        """Raises ValueError for a degree that is none from `lowest` on, which depends on the problem."""
        if self.degree is not None:
            whole("degree", self.degree, lowest, HIGHEST_DEGREE)


@dataclass(frozen=True)
class Targets:
    """Places where orbits of a family are wanted exactly, and its ends but for its largest amplitude.

    Attributes:
        at: values of S, ascending.
        at_Omega: frequencies, each once.
        at_period: periods, each once.
        period_max: the period at which the family ends where that comes first.
        max_points: number of points after which it ends wherever it is.

    Raises ValueError and TypeError, naming the argument, for other values.
    """

    at: Sequence[float] = ()
    at_Omega: Sequence[float] = ()
    at_period: Sequence[float] = ()
    period_max: float | None = None
    max_points: int = MAX_POINTS

    def __post_init__(self) -> None:
        for name in ("at", "at_Omega", "at_period"):
            object.__setattr__(self, name, numbers(name, getattr(self, name)))
        if self.period_max is not None:
            number("period_max", self.period_max)
        whole("max_points", self.max_points, 1)

    def check(self, amplitude_max: float, linear_period: float, mode: int) -> None:
        """Raises ValueError for values that the family does not come to: above its ends, or below its linear period."""
        ascending = all(a < b for a, b in zip(self.at, self.at[1:], strict=False))
        if not ascending or any(not 0 < a <= amplitude_max for a in self.at):
            raise ValueError(f"at: given {list(self.at)}; accepted: ascending numbers > 0 up to {amplitude_max:g}")
        longest = math.inf if self.period_max is None else self.period_max
        if self.period_max is not None and not linear_period * (1.0 + SAME) < self.period_max < math.inf:
            accepted = f"a finite number > {linear_period:.12g} (the period of linear mode {mode})"
            raise ValueError(f"period_max: given {self.period_max!r}; accepted: {accepted}")
        for name, values, within in (
            ("at_Omega", self.at_Omega, [TWO_PI / value <= longest for value in self.at_Omega if value > 0]),
            ("at_period", self.at_period, [value <= longest for value in self.at_period]),
        ):
            positive = all(0 < value < math.inf for value in values)
            if not positive or len(set(values)) < len(values) or not all(within):
                most = "" if self.period_max is None else f", with periods up to period_max = {longest:g}"
                raise ValueError(f"{name}: given {list(values)}; accepted: finite numbers > 0, each once{most}")
