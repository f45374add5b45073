"""How the unknowns of a search lie: free numbers first, then of every orbit its values, Omega^2 and its tangent."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from casadi_skin.bvp.trigonometric import prolongation_matrix
from casadi_skin.optimise.request import SearchRequest
from casadi_skin.theory.linear import Array

SLOWEST = 1e-6  # Omega^2 beside the largest stiffness: what the square root is kept away from


class SearchLayout:
    """Places of the unknowns and of the constraints of a request on a number of harmonics.

    `sizes` counts the unknowns of each orbit, `state` those of its values with Omega^2, `has_tangent` tells which have
    a tangent as well, `rows` counts the rows of each condition and `equations` those of all orbits.
    """

    request: SearchRequest
    harmonics: int
    free_count: int
    sizes: tuple[int, ...]
    state: int
    has_tangent: tuple[bool, ...]
    rows: tuple[int, ...]
    equations: int

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self.free_count + sum(self.sizes)

    @cached_property
    def starts(self) -> tuple[int, ...]:
        """Where the unknowns of each orbit begin."""
        return tuple(self.free_count + sum(self.sizes[:k]) for k in range(len(self.sizes)))

    def free_of(self, x: Array) -> Array:
        """The free numbers, shape (free_count,)."""
        return np.asarray(x[: self.free_count])

    def state_of(self, x: Array, orbit: int) -> Array:
        """Values at the nodes, shape (sites, harmonics), of one orbit."""
        first = self.starts[orbit]
        return np.asarray(x[first : first + self.state - 1].reshape(self.request.chain.sites, self.harmonics))

    def square_of(self, x: Array, orbit: int) -> float:
        """Omega^2 of one orbit."""
        return float(x[self.starts[orbit] + self.state - 1])

    def frequencies(self, x: Array) -> Array:
        """Omega of every orbit, shape (orbits,)."""
        return np.sqrt([self.square_of(x, k) for k in range(len(self.sizes))])

    def parameter(self, x: Array, name: str) -> Array:
        """The value of gamma, alpha, g (scalars) or alpha_n (sites,) at x, free or not."""
        free, chain = self.request.free_names, self.request.chain
        if name == "alpha_n":
            alpha = np.full(chain.sites, float(self.parameter(x, "alpha")) if "alpha_1" not in free else np.nan)
            return x[free.index("alpha_1") :][: chain.sites].copy() if "alpha_1" in free else alpha
        if name == "alpha" and "alpha_1" in free:
            return np.asarray(np.mean(self.parameter(x, "alpha_n")))
        return np.asarray(x[free.index(name)] if name in free else getattr(chain, name))

    def amplitude(self, x: Array, orbit: int) -> float:
        """S of one orbit."""
        names = self.request.free_names
        return float(x[names.index("S")]) if "S" in names else self.request.amplitudes[orbit]

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds of the unknowns."""
        lower, upper = np.full(self.size, -np.inf), np.full(self.size, np.inf)
        for i, (low, high) in enumerate(self.request.limits):
            lower[i], upper[i] = low, high
        for first in self.starts:
            lower[first + self.state - 1] = SLOWEST
        return lower, upper

    @cached_property
    def condition_bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds of the constraints: equations first, then the conditions of the request."""
        pairs = [(c.lower, c.upper) for c, rows in zip(self.request.conditions, self.rows, strict=True)
                 for _ in range(rows)]  # fmt: skip
        zero = np.zeros(self.equations)
        return np.append(zero, [low for low, _ in pairs]), np.append(zero, [high for _, high in pairs])

    def row_names(self) -> list[str]:
        """The name of each constraint's row."""
        names = ["the equations of the orbit"] * self.equations
        for condition, rows in zip(self.request.conditions, self.rows, strict=True):
            names += [condition.name] * rows
        return names

    def prolonged(self, x: Array, finer: SearchLayout) -> Array:
        """The same point on another number of harmonics."""
        matrix, parts = prolongation_matrix(self.harmonics, finer.harmonics), [self.free_of(x)]
        sites, n = self.request.chain.sites, self.state - 1
        for k, first in enumerate(self.starts):
            for begin in [first] + ([first + self.state] if self.has_tangent[k] else []):
                parts += [(x[begin : begin + n].reshape(sites, self.harmonics) @ matrix).ravel(), x[[begin + n]]]
        return np.concatenate(parts)

    @cached_property
    def scales(self) -> Array:
        """Ranges of the free numbers and of Omega^2, in which distances are measured."""
        spans = [high - low if np.isfinite(high - low) else 1.0 for low, high in self.request.limits]
        return np.array([*spans, *[1.0] * len(self.sizes)])

    def place(self, x: Array) -> Array:
        """Free numbers and squared frequencies, in which optima are told apart."""
        return np.concatenate([self.free_of(x), [self.square_of(x, k) for k in range(len(self.sizes))]])
