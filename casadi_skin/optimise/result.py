"""What a search found: its distinct optima, sorted, each with its checks, and what every start led to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from casadi_skin.bvp.trigonometric import cosine_matrix
from casadi_skin.lattice.chain import Chain
from casadi_skin.optimise.optimality import Kkt
from casadi_skin.optimise.starts import Outcome
from casadi_skin.optimise.verify import PlainCheck
from casadi_skin.theory.linear import Array


class SearchStatus(Enum):
    """How a search ended."""

    FOUND = "found an optimum inside its bounds"
    ON_BOUND = "the best optimum sits on a bound"
    INFEASIBLE = "no start met the constraints"
    UNBOUNDED = "the objective is unbounded"
    INTERRUPTED = "interrupted"
    FAILED = "no start converged"


@dataclass(frozen=True, eq=False)
class FoundOrbit:
    """An orbit of an optimum: y_n(t) = sum_k c_kn cos((2k+1) Omega t), in physical coordinates; dimensionless.

    `coefficients` has shape (harmonics, sites); `values` are the named quantities (of the slopes those that the search
    asked for).
    """

    S: float
    Omega: float
    coefficients: Array
    values: Mapping[str, float]
    check: PlainCheck

    def evaluate(self, t: ArrayLike) -> Array:
        """Displacements y_n(t), shape (time, site); the largest at t = 0 is positive."""
        odd = 2 * np.arange(self.coefficients.shape[0]) + 1
        times = np.atleast_1d(np.asarray(t, dtype=float))
        return np.asarray(np.cos(np.outer(self.Omega * times, odd)) @ self.coefficients)

    @cached_property
    def profile(self) -> Array:
        """Displacements at t = 0, where all velocities vanish, shape (sites,)."""
        return np.asarray(self.coefficients.sum(axis=0))


@dataclass(frozen=True, eq=False)
class Optimum:
    """A local optimum: parameters, orbits and what was checked of it.

    `parameters` are the free numbers by name, `alpha_n` (sites,) the on-site stiffness of every site. `errors` are
    estimated absolute errors of objective, Omega and free numbers by discretisation (the step to more harmonics).
    `active` names the bounds that hold, such as "gamma >= 0". `curvature` is the smallest eigenvalue of the Hessian of
    the Lagrangian (of the negative objective where that is maximised) in the free numbers that the constraints leave:
    positive at a strict optimum, infinite where nothing is left. `starts` are the numbers of those that led here.
    """

    objective: float
    parameters: Mapping[str, float]
    alpha_n: Array
    gamma: float
    g: float
    orbits: tuple[FoundOrbit, ...]
    conditions: Mapping[str, Array]
    active: tuple[str, ...]
    kkt: Kkt
    curvature: float
    errors: Mapping[str, float]
    harmonics: int
    starts: tuple[int, ...]
    x: Array

    @property
    def on_family(self) -> bool | None:
        """Whether every orbit belongs to the family asked for; None where that is not known."""
        known = [orbit.check.on_family(orbit.Omega) for orbit in self.orbits]
        return None if None in known else all(known)

    @property
    def orbit(self) -> FoundOrbit:
        """The first orbit; the only one where S is one number."""
        return self.orbits[0]

    @property
    def S(self) -> float:
        """S of the first orbit."""
        return self.orbits[0].S

    @property
    def Omega(self) -> float:
        """Omega of the first orbit."""
        return self.orbits[0].Omega


@dataclass(frozen=True, eq=False)
class SearchResult:
    """Distinct optima, best first, of the family asked for; `others` are optima on orbits that are not of it.

    `status` and the sentence `reason` tell how the search ended. Where there is no optimum, `nearest` is the point that
    comes nearest: of an infeasible search the orbit that misses the constraints least, else the outcome with the
    least violation. `outcomes` has one item a start done, and another for each that was used again by deflation.
    """

    chain: Chain
    mode: int
    status: SearchStatus
    reason: str
    optima: tuple[Optimum, ...]
    others: tuple[Optimum, ...]
    outcomes: tuple[Outcome, ...]
    nearest: Outcome | None
    seconds: float

    @property
    def best(self) -> Optimum:
        """The best optimum; raises ValueError with the reason where there is none."""
        if not self.optima:
            raise ValueError(f"search: no optimum; {self.reason}")
        return self.optima[0]

    @property
    def found(self) -> bool:
        """Whether there is an optimum on the family."""
        return bool(self.optima)


def physical_coefficients(values: Array, scale: Array) -> Array:
    """Coefficients (harmonics, sites) of displacements from scaled gauge positions at the nodes (sites, harmonics).

    `scale` has sqrt(S) rho_n. The sign makes the largest displacement at t = 0 positive.
    """
    harmonics = values.shape[1]
    found = (2.0 / harmonics) * cosine_matrix(harmonics) @ (values * scale[:, None]).T
    start = found.sum(axis=0)
    return np.asarray(found * np.sign(start[np.argmax(np.abs(start))]))
