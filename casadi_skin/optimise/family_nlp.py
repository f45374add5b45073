"""The orbits of a search in odd cosines as a nonlinear programme.

Unknown are the free numbers and then, of every orbit, its values at the nodes, its squared frequency and, where an
objective or a condition uses a slope, its tangent.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from casadi_skin.follow.orbit import Orbit
from casadi_skin.optimise.family_statement import FamilyStatement
from casadi_skin.optimise.nlp import Limits, Nlp
from casadi_skin.zero.cosines import prolongation_matrix
from casadi_skin.zero.problem import Array, Indices

SLOWEST = 1e-6  # Omega^2 beside the largest stiffness: the square root is kept above it
OPTIONS: Mapping[str, Any] = {
    "ipopt.tol": 1e-10,
    "ipopt.constr_viol_tol": 1e-10,
    "ipopt.compl_inf_tol": 1e-9,
    "ipopt.max_iter": 400,  # rounding of the start alone makes 120 to 250 of a chain with every stiffness free
    "ipopt.theta_max_fact": 1.0,  # no iterate violates more than the start, or 1: far from orbits nothing is bounded
    "ipopt.diverging_iterates_tol": 1e8,
}


class FamilyNlp(Nlp):
    """The nonlinear programme of a search on a number of harmonics."""

    def __init__(self, search: FamilyStatement, harmonics: int) -> None:
        self.search, self.harmonics = search, harmonics
        free, orbits = search.symbols(harmonics)
        objective = ca.SX(search.evaluated(search.objective, orbits))
        conditions = [ca.SX(search.evaluated(c.quantity, orbits)) for c in search.conditions]
        self.has_tangent = any(orbit.tangent is not None for orbit in orbits)
        if self.has_tangent:
            _ = [orbit.slope(orbit.S) for orbit in orbits]  # all orbits have the same unknowns
        equations = [orbit.residual() for orbit in orbits]
        self.free_count, self._orbits = int(free.numel()), orbits
        self._shape = (len(orbits), 1 + self.has_tangent, search.family.size * harmonics + 1)
        held = [] if "S" in search.free else [orbit.S for orbit in orbits]
        super().__init__(
            ca.vertcat(free, *(orbit.unknowns for orbit in orbits)), objective, ca.vertcat(*equations, *conditions),
            self._limits([c.numel() for c in conditions]), p=ca.vertcat(*held) if held else ca.SX(0, 1),
            values=search.amplitudes if held else (), jacobian=self._by_blocks(free, equations, conditions),
            maximise=search.maximise, options=OPTIONS,
        )  # fmt: skip
        scales = [high - low if np.isfinite(high - low) else 1.0 for low, high in search.limits]
        squares = [orbit.Omega_squared for orbit in orbits]
        self.place = ca.vertcat(free / ca.DM(scales), *squares)

    def _limits(self, rows: Sequence[int]) -> Limits:
        """Bounds of the free numbers and of Omega^2; equations first, then the conditions."""
        search, size = self.search, int(np.prod(self._shape))
        lower, upper = np.full(self.free_count + size, -np.inf), np.full(self.free_count + size, np.inf)
        lower[: self.free_count], upper[: self.free_count] = np.array(search.limits).T
        self._parts(lower)[:, 0, -1] = SLOWEST
        held, first, conditions = search.conditions, size, dict[str, Indices]()
        for item, (condition, count) in enumerate(zip(held, rows, strict=True), start=1):
            name = condition.name if condition.name not in conditions else f"{condition.name} ({item})"
            conditions[name] = np.arange(first, first := first + count)
        low, high = (np.append(np.zeros(size), np.repeat(ends, rows)) for ends in
                     ([c.lower for c in held], [c.upper for c in held]))  # fmt: skip
        unknowns = {name: np.array([i]) for i, name in enumerate(search.free_names)}
        return Limits(lower, upper, low, high, unknowns, conditions)

    def _by_blocks(self, free: ca.SX, equations: list[ca.SX], conditions: list[ca.SX]) -> ca.SX:
        """Derivative of the constraints, block by block: dense rows beside dense columns would spoil the colouring."""

        def blocks(columns: Sequence[ca.SX]) -> list[ca.SX]:
            states = [part for column in columns for part in ca.vertsplit(column, self._shape[2])]
            return [block for part in states for block in (part[:-1], part[-1])]

        rows, columns = (*blocks(equations), *conditions), (free, *blocks([o.unknowns for o in self._orbits]))
        return ca.vertcat(*(ca.horzcat(*(ca.jacobian(row, column) for column in columns)) for row in rows))

    # Places of the unknowns -----------------------------------------------------------------------------------------

    @property
    def measured(self) -> Indices:
        return np.arange(self.free_count)

    def _parts(self, x: Array) -> Array:
        """A view of the orbits' unknowns, shape (orbits, 1 or 2 with the tangent, values with Omega^2)."""
        return x[self.free_count :].reshape(self._shape)

    def state_of(self, x: Array, orbit: int) -> Array:
        """Values at the nodes of one orbit, shape (components, harmonics)."""
        return self._parts(x)[orbit, 0, :-1].reshape(-1, self.harmonics)

    def frequencies(self, x: Array) -> Array:
        """Omega of every orbit, shape (orbits,)."""
        return np.asarray(np.sqrt(self._parts(x)[:, 0, -1]))

    def amplitude(self, x: Array, orbit: int) -> float:
        """S of one orbit."""
        search = self.search
        return float(x[search.free_names.index("S")]) if "S" in search.free else search.amplitudes[orbit]

    # Points ---------------------------------------------------------------------------------------------------------

    def packed(self, free: Sequence[float], members: Sequence[Orbit]) -> Array:
        """Unknowns from the free numbers and the orbits; tangents are solved for."""
        from scipy.sparse.linalg import splu

        theta = (np.arange(self.harmonics) + 0.5) * np.pi / (2 * self.harmonics)
        x = np.concatenate([free, np.zeros(int(np.prod(self._shape)))])
        for part, member in zip(self._parts(x), members, strict=True):
            part[0] = np.append(self.search.family.nodes(member, theta).ravel(), member.Omega**2)
        if self.has_tangent:
            residual, jacobian, state = self.residual(x), self.jacobian(x), self._shape[2]
            for k, part in enumerate(self._parts(x)):
                rows = slice((2 * k + 1) * state, (2 * k + 2) * state)
                columns = slice(rows.start + self.free_count, rows.stop + self.free_count)
                part[1] = -splu(jacobian[rows, columns]).solve(residual[rows])
        return x

    def prolonged(self, x: Array, finer: FamilyNlp) -> Array:
        """The same point on another number of harmonics."""
        parts, matrix = self._parts(x), prolongation_matrix(self.harmonics, finer.harmonics)
        states = parts[..., :-1].reshape(*self._shape[:2], -1, self.harmonics) @ matrix
        return np.append(
            x[: self.free_count], np.dstack([states.reshape(*self._shape[:2], -1), parts[..., -1:]]).ravel()
        )

    def values(self, x: Array) -> list[dict[str, Any]]:
        """Quantities of every orbit by name, numbers or arrays; slopes only where there are tangents."""
        found = []
        for orbit in self._orbits:
            names = [n for n in orbit.names if self.has_tangent or not n.endswith("_slope")]
            function = ca.Function("values", [self._x, self._p], [ca.densify(orbit.value(n)) for n in names])
            results = [np.array(value).ravel() for value in function.call([x, self.p])]
            found.append({n: float(v[0]) if v.size == 1 else v for n, v in zip(names, results, strict=True)})
        return found
