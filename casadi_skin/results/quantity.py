"""A quantity of a solution, and a solution with its marks: the elements of tables and datasets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.follow.orbit import Orbit
from casadi_skin.follow.solution import Solution
from casadi_skin.results.extremes import extremes
from casadi_skin.stability.result import Floquet

CSV, NETCDF, BOTH, NEITHER = "csv", "netcdf", "both", "neither"  # files: those of NEITHER follow from others
COUNTED = frozenset(  # marks, counts and words, which jump: no solution is sought by their value
    ("mode", "point", "index", "requested", "fold", "special", "stable", "unstable", "unstable_real",
     "unstable_complex", "at_round_off", "intervals", "resolution", "regime", "proved", "proved_stable", "localised",
     "undecided", "finite_size", "stability_sites", "overlaps")
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Place:
    """A solution of a branch with the data of its quantities: its place, and marks."""

    solution: Solution
    index: int
    mode: int = 0
    requested: bool = False
    special: str = ""

    @property
    def orbit(self) -> Orbit:
        """The solution, where it is an orbit."""
        assert isinstance(self.solution, Orbit)
        return self.solution

    @property
    def floquet(self) -> Floquet:
        """Stability of the solution, an orbit or one that its conditions close."""
        return self.solution.floquet()

    @cached_property
    def extremes(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Smallest and largest value of each state, shapes (components,)."""
        return extremes(self.solution)


@dataclass(frozen=True, eq=False)
class Quantity:
    """A quantity of a solution: `of` gives its value, an array where it has `dimensions`."""

    name: str
    meaning: str
    of: Callable[[Place], Any]
    dimensions: tuple[str, ...] = ()
    where: str = BOTH
    may_be_empty: bool = False
