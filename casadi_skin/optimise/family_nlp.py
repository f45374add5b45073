"""The orbits of a search in odd cosines as a nonlinear programme.

Unknown are the free numbers and then, of every orbit, its values at the nodes, its squared frequency and, where an
objective or a condition uses a slope, its tangent.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from casadi_skin.bvp.problem import Array, Indices
from casadi_skin.bvp.trigonometric import prolongation_matrix
from casadi_skin.optimise.family import Member
from casadi_skin.optimise.nlp import Limits, Nlp

if TYPE_CHECKING:
    from casadi_skin.optimise.family_search import FamilySearch

SLOWEST = 1e-6  # Omega^2 beside the largest stiffness: what the square root is kept away from
OPTIONS: Mapping[str, Any] = {
    "ipopt.tol": 1e-10,
    "ipopt.constr_viol_tol": 1e-10,
    "ipopt.compl_inf_tol": 1e-9,
    "ipopt.max_iter": 200,
    "ipopt.mumps_pivtol": 1e-2,  # with 1e-6 the first multipliers are noise, and some starts run away
    "ipopt.theta_max_fact": 1.0,  # no iterate violates more than the start, or 1: far from orbits nothing is bounded
    "ipopt.diverging_iterates_tol": 1e8,
}


@dataclass(frozen=True)
class _Blocks:
    """Where the unknowns of one orbit begin, how many there are, and whether a tangent is among them."""

    first: int
    size: int
    tangent: bool


class FamilyNlp(Nlp):
    """The nonlinear programme of a search on a number of harmonics."""

    def __init__(self, search: FamilySearch, harmonics: int) -> None:
        self.search, self.harmonics = search, harmonics
        free, orbits = search.symbols(harmonics)
        objective = ca.SX(search.evaluated(search.objective, orbits))
        conditions = [ca.SX(search.evaluated(c.quantity, orbits)) for c in search.conditions]
        equations = [orbit.residual() for orbit in orbits]
        self.free_count, self.state = int(free.numel()), search.family.size * harmonics + 1
        self._orbits, self._blocks, first = orbits, list[_Blocks](), self.free_count
        for orbit in orbits:
            self._blocks.append(_Blocks(first, int(orbit.unknowns.numel()), orbit.tangent is not None))
            first += self._blocks[-1].size
        held = [] if "S" in search.free else [orbit.S for orbit in orbits]
        super().__init__(
            ca.vertcat(free, *(orbit.unknowns for orbit in orbits)),
            objective,
            ca.vertcat(*equations, *conditions),
            self._limits(first, sum(e.numel() for e in equations), [c.numel() for c in conditions]),
            p=ca.vertcat(*held) if held else ca.SX(0, 1),
            values=search.amplitudes if held else (),
            jacobian=self._by_blocks(free, equations, conditions),
            maximise=search.maximise,
            options=OPTIONS,
        )
        squares = [self._x[block.first + self.state - 1] for block in self._blocks]
        self.place = ca.vertcat(free, *squares) / ca.DM(self._scales)

    def _limits(self, size: int, equations: int, rows: Sequence[int]) -> Limits:
        """Bounds of the free numbers and of Omega^2; equations first, then the conditions."""
        search = self.search
        lower, upper = np.full(size, -np.inf), np.full(size, np.inf)
        lower[: self.free_count], upper[: self.free_count] = np.array(search.limits).T
        for block in self._blocks:
            lower[block.first + self.state - 1] = SLOWEST
        low, high, conditions = [np.zeros(equations)], [np.zeros(equations)], dict[str, Indices]()
        for item, (condition, count) in enumerate(zip(search.conditions, rows, strict=True), start=1):
            first = sum(part.size for part in low)
            name = condition.name if condition.name not in conditions else f"{condition.name} ({item})"
            conditions[name] = np.arange(first, first + count)
            low.append(np.full(count, condition.lower))
            high.append(np.full(count, condition.upper))
        unknowns = {name: np.array([i]) for i, name in enumerate(search.free_names)}
        return Limits(lower, upper, np.concatenate(low), np.concatenate(high), unknowns, conditions)

    def _by_blocks(self, free: ca.SX, equations: list[ca.SX], conditions: list[ca.SX]) -> ca.SX:
        """Derivative of the constraints, block by block: dense rows beside dense columns would spoil the colouring."""
        last, states = self.state - 1, [o.unknowns for o in self._orbits]
        rows = [block for e in equations for part in ca.vertsplit(e, self.state) for block in (part[:last], part[last])]
        columns = [block for x in states for part in ca.vertsplit(x, self.state) for block in (part[:last], part[last])]
        blocks = [[ca.jacobian(row, column) for column in (free, *columns)] for row in (*rows, *conditions)]
        return ca.vertcat(*(ca.horzcat(*row) for row in blocks))

    # Places of the unknowns -----------------------------------------------------------------------------------------

    @property
    def measured(self) -> Indices:
        return np.arange(self.free_count)

    @property
    def has_tangent(self) -> bool:
        """Whether any orbit has a tangent."""
        return any(block.tangent for block in self._blocks)

    def state_of(self, x: Array, orbit: int) -> Array:
        """Values at the nodes of one orbit, shape (components, harmonics)."""
        first = self._blocks[orbit].first
        return np.asarray(x[first : first + self.state - 1].reshape(-1, self.harmonics))

    def frequencies(self, x: Array) -> Array:
        """Omega of every orbit, shape (orbits,)."""
        return np.sqrt([x[block.first + self.state - 1] for block in self._blocks])

    def amplitude(self, x: Array, orbit: int) -> float:
        """S of one orbit."""
        search = self.search
        return float(x[search.free_names.index("S")]) if "S" in search.free else search.amplitudes[orbit]

    @property
    def _scales(self) -> Array:
        """Ranges of the free numbers and 1 for Omega^2, in which distances between optima are measured."""
        spans = [high - low if np.isfinite(high - low) else 1.0 for low, high in self.search.limits]
        return np.array([*spans, *[1.0] * len(self._blocks)])

    # Points ---------------------------------------------------------------------------------------------------------

    def packed(self, free: Sequence[float], members: Sequence[Member]) -> Array:
        """Unknowns from the free numbers and the orbits; tangents are solved for."""
        theta, parts = (np.arange(self.harmonics) + 0.5) * np.pi / (2 * self.harmonics), [np.array(free, dtype=float)]
        for member, block in zip(members, self._blocks, strict=True):
            parts += [
                member.sample(theta).T.ravel(),
                np.array([member.Omega**2]),
                np.zeros(self.state if block.tangent else 0),
            ]
        x = np.concatenate(parts)
        return self._with_tangents(x) if self.has_tangent else x

    def _with_tangents(self, x: Array) -> Array:
        from scipy.sparse.linalg import splu

        x, residual, jacobian = x.copy(), self.residual(x), self.jacobian(x)
        for block in self._blocks:
            if block.tangent:
                row, column = (first + self.state for first in (block.first - self.free_count, block.first))
                rows, columns = slice(row, row + self.state), slice(column, column + self.state)
                x[columns] -= splu(jacobian[rows, columns]).solve(residual[rows])
        return x

    def prolonged(self, x: Array, finer: FamilyNlp) -> Array:
        """The same point on another number of harmonics."""
        matrix, parts, n = prolongation_matrix(self.harmonics, finer.harmonics), [x[: self.free_count]], self.state - 1
        for block in self._blocks:
            for first in (block.first, block.first + self.state)[: 1 + block.tangent]:
                parts += [(x[first : first + n].reshape(-1, self.harmonics) @ matrix).ravel(), x[[first + n]]]
        return np.concatenate(parts)

    def values(self, x: Array) -> list[dict[str, Any]]:
        """Quantities of every orbit by name, numbers or arrays; slopes only of orbits that have the tangent."""
        found = []
        for orbit, block in zip(self._orbits, self._blocks, strict=True):
            names = [n for n in orbit.names if block.tangent or not n.endswith("_slope")]
            function = ca.Function("values", [self._x, self._p], [ca.densify(orbit.value(n)) for n in names])
            results = [np.array(value).ravel() for value in function.call([x, self.p])]
            found.append({n: float(v[0]) if v.size == 1 else v for n, v in zip(names, results, strict=True)})
        return found

    def conditions(self, x: Array) -> dict[str, Array]:
        """Values of the conditions by name."""
        residual = self.residual(x)
        return {name: residual[rows] for name, rows in self.limits.conditions.items()}
