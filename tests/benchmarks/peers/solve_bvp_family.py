"""The family followed with scipy.integrate.solve_bvp, all derivatives given.

    (q, v)' = tau (v, -L q - g S w q^3),  time scaled to [0, 1],  tau = (pi/2) / Omega
    v(0) = 0,  q(1) = 0,  sum_n w_n q_n(0)^2 = 1

solve_bvp solves one two-point problem; the walk along the family is written here, in two ways. With S given (the family
has no fold in S) tau is the only parameter, and the guess is extrapolated from the solutions before. With the
arclength given, S is a parameter too, and one more boundary condition, in q(0), tau and S, holds the step. Multipliers
are not part of solve_bvp: solve_ivp (DOP853) integrates the flow over the quarter with its derivative.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from family_case import Array, Family, FamilyCase, largest_multiplier
from scipy.integrate import solve_bvp, solve_ivp


@dataclass(frozen=True)
class BvpSettings:
    """`tol` bounds the relative residual; `nodes` are the first mesh; `step` is the longest in S or arclength."""

    tol: float
    nodes: int
    step: float
    first: float = 0.05  # step
    arclength: bool = False
    memory: int = 4  # solutions that the guess is extrapolated from


# Found by trying, for an Omega good to about 1e-8. solve_bvp never coarsens a mesh, so that one bad guess is paid for
# to the end: the first mesh is nearly fine enough, and longer steps than these are dearer.
BEST = {
    "S, longest steps": BvpSettings(tol=5e-6, nodes=61, step=0.6),
    "S, steps to 0.1": BvpSettings(tol=5e-6, nodes=61, step=0.1),
    "arclength": BvpSettings(tol=5e-6, nodes=61, step=0.5, arclength=True),
}


@dataclass
class Quarter:
    """Equations, boundary conditions and their derivatives, as solve_bvp wants them; one problem per S or arclength."""

    case: FamilyCase
    row: Array | None = None  # of the arclength condition, over (q(0), tau, S)
    value: float = 0.0
    S: float = 0.0
    matrix: Array = field(init=False)

    def __post_init__(self) -> None:
        chain, n = self.case.chain, self.case.sites
        off = np.full(n - 1, chain.coupling)
        self.matrix = np.diag(np.full(n, -2.0 - chain.alpha)) + np.diag(off, 1) + np.diag(off, -1)
        self.weights, self.n = chain.weights[:, None], n

    def of(self, p: Array) -> tuple[float, float]:
        """tau and S."""
        return float(p[0]), self.S if self.row is None else float(p[1])

    def rhs(self, x: Array, y: Array, p: Array) -> Array:
        tau, S = self.of(p)
        q, v = y[: self.n], y[self.n :]
        return tau * np.vstack((v, self.matrix @ q - self.case.chain.g * S * self.weights * q**3))

    def rhs_jacobian(self, x: Array, y: Array, p: Array) -> tuple[Array, Array]:
        n, (tau, S), g = self.n, self.of(p), self.case.chain.g
        by_y = np.zeros((2 * n, 2 * n, y.shape[1]))
        by_y[np.arange(n), n + np.arange(n)] = tau
        by_y[n:, :n] = tau * self.matrix[:, :, None]
        by_y[n + np.arange(n), np.arange(n)] -= 3.0 * tau * g * S * self.weights * y[:n] ** 2
        by_p = np.zeros((2 * n, len(p), y.shape[1]))
        by_p[:, 0] = self.rhs(x, y, p) / tau
        if self.row is not None:
            by_p[n:, 1] = -tau * g * self.weights * y[:n] ** 3
        return by_y, by_p

    def boundary(self, ya: Array, yb: Array, p: Array) -> Array:
        n = self.n
        rest = [self.weights[:, 0] @ ya[:n] ** 2 - 1.0]
        if self.row is not None:
            rest.append(self.row @ np.concatenate((ya[:n], p)) - self.value)
        return np.concatenate((ya[n:], yb[:n], rest))

    def boundary_jacobian(self, ya: Array, yb: Array, p: Array) -> tuple[Array, Array, Array]:
        n = self.n
        size = 2 * n + len(p)
        by_a, by_b, by_p = np.zeros((size, 2 * n)), np.zeros((size, 2 * n)), np.zeros((size, len(p)))
        by_a[np.arange(n), n + np.arange(n)] = 1.0
        by_b[n + np.arange(n), np.arange(n)] = 1.0
        by_a[2 * n, :n] = 2.0 * self.weights[:, 0] * ya[:n]
        if self.row is not None:
            by_a[-1, :n], by_p[-1] = self.row[:n], self.row[n:]
        return by_a, by_b, by_p


@dataclass(frozen=True)
class Orbit:
    """A solution: spline over [0, 1], its mesh, tau and S."""

    curve: object
    x: Array
    tau: float
    S: float

    def at(self, x: Array) -> Array:
        return np.asarray(self.curve(x))  # type: ignore[operator]


def extrapolate(positions: list[float], values: list[Array], to: float) -> Array:
    """Lagrange's polynomial through the values."""
    total = np.zeros_like(values[0])
    for i, (xi, value) in enumerate(zip(positions, values, strict=True)):
        total = total + value * np.prod([(to - xk) / (xi - xk) for k, xk in enumerate(positions) if k != i])
    return total


class BvpWalk:
    """The walk along the family; `orbits` has its points."""

    def __init__(self, case: FamilyCase, settings: BvpSettings) -> None:
        self.case, self.settings = case, settings
        self.tau = 0.5 * np.pi / case.omega
        self.orbits: list[Orbit] = []

    def linear(self, x: Array) -> Array:
        """The linear mode, start of the family."""
        omega, mode = self.case.omega, self.case.start[:, None]
        angle = 0.5 * np.pi * x
        return np.vstack((mode * np.cos(angle), -omega * mode * np.sin(angle)))

    def solve(self, problem: Quarter, x: Array, guess: Array, p: list[float]) -> Orbit | None:
        """One call of solve_bvp; None where it fails.

        After the first, a mesh that would grow by more than a quarter is a failure: the guess was bad, and solve_bvp
        tends to go on to another orbit on a thousand nodes without saying so.
        """
        most = int(1.25 * len(x)) + 8 if self.orbits else 2000
        found = solve_bvp(
            problem.rhs, problem.boundary, x, guess, p, tol=self.settings.tol, bc_tol=1e-2 * self.settings.tol,
            fun_jac=problem.rhs_jacobian, bc_jac=problem.boundary_jacobian, max_nodes=most,
        )  # fmt: skip
        if found.status != 0:
            return None
        assert found.p is not None
        tau, S = problem.of(found.p)
        return Orbit(found.sol, found.x, tau, S)

    def at_S(self, S: float) -> Orbit | None:
        """The orbit at one S from the orbits before."""
        last = self.orbits[-self.settings.memory :]
        x = self.orbits[-1].x
        known = [orbit.S for orbit in last]
        guess = extrapolate(known, [orbit.at(x) for orbit in last], S)
        tau = float(extrapolate(known, [np.array(orbit.tau) for orbit in last], S))
        return self.solve(Quarter(self.case, S=S), x, guess, [tau])

    def start(self) -> None:
        """The linear mode itself, S = 0."""
        x = np.linspace(0.0, 1.0, self.settings.nodes)
        first = self.solve(Quarter(self.case), x, self.linear(x), [self.tau])
        assert first is not None
        self.orbits.append(first)

    def by_S(self) -> None:
        """S given: steps that grow by half, up to the longest, halved where solve_bvp fails."""
        step = self.settings.first
        for wanted in self.case.at:
            while (here := self.orbits[-1].S) < wanted:
                parts = int(np.ceil((wanted - here) / step - 1e-9))
                if (orbit := self.at_S(wanted if parts == 1 else here + (wanted - here) / parts)) is None:
                    step = self.halved(step)
                    continue
                self.orbits.append(orbit)
                step = min(1.5 * step, self.settings.step)

    def halved(self, step: float) -> float:
        """Half the step; RuntimeError where it is too short to go on."""
        if step < 1e-4:
            raise RuntimeError(f"no convergence beyond S = {self.orbits[-1].S}")
        return 0.5 * step

    def vector(self, orbit: Orbit) -> Array:
        """What the arclength is measured in: q(0), tau and S."""
        return np.concatenate((orbit.at(np.array([0.0]))[: self.case.sites, 0], [orbit.tau, orbit.S]))

    def by_arclength(self) -> None:
        """Arclength given, steps as for S; at the S asked for, S."""
        step = self.settings.first
        self.orbits.append(self.required(self.at_S(0.02)))
        for wanted in self.case.at:
            while True:
                chord = self.vector(self.orbits[-1]) - self.vector(self.orbits[-2])
                if (orbit := self.along(chord / np.linalg.norm(chord), step)) is None:
                    step = self.halved(step)
                    continue
                if wanted <= orbit.S:
                    break
                self.orbits.append(orbit)
                step = min(1.5 * step, self.settings.step)
            self.orbits.append(self.required(self.at_S(wanted)))

    def required(self, orbit: Orbit | None) -> Orbit:
        if orbit is None:
            raise RuntimeError(f"no convergence beyond S = {self.orbits[-1].S}")
        return orbit

    def along(self, row: Array, step: float) -> Orbit | None:
        """The orbit one step of arclength ahead, guess extrapolated in the arclength."""
        last = self.orbits[-self.settings.memory :]
        x = self.orbits[-1].x
        known = [float(row @ self.vector(orbit)) for orbit in last]
        to = known[-1] + step
        guess = extrapolate(known, [orbit.at(x) for orbit in last], to)
        p = extrapolate(known, [np.array([orbit.tau, orbit.S]) for orbit in last], to)
        return self.solve(Quarter(self.case, row, to), x, guess, [float(value) for value in p])

    def family(self, multipliers: bool) -> Family:
        """Follow the family from its start."""
        self.orbits = []
        self.start()
        if self.settings.arclength:
            self.by_arclength()
        else:
            self.by_S()
        S, tau = (np.array([getattr(orbit, name) for orbit in self.orbits]) for name in ("S", "tau"))
        found = np.array([self.multiplier(orbit) for orbit in self.orbits]) if multipliers else None
        return Family(S, 0.5 * np.pi / tau, found)

    def multiplier(self, orbit: Orbit, tolerance: float = 1e-9) -> float:
        """Largest |multiplier|: the flow over the quarter from q(0) and its derivative, by DOP853."""
        n, size = self.case.sites, 2 * self.case.sites
        problem = Quarter(self.case, S=orbit.S)
        kappa = 3.0 * self.case.chain.g * orbit.S * problem.weights

        def rhs(t: float, z: Array) -> Array:
            columns = z.reshape(size, size + 1)
            q, v = columns[:n], columns[n:]
            force = problem.matrix @ q
            force[:, 1:] -= kappa * q[:, :1] ** 2 * q[:, 1:]
            force[:, :1] -= kappa / 3.0 * q[:, :1] ** 3
            return np.vstack((v, force)).ravel()

        start = np.hstack((orbit.at(np.array([0.0])), np.eye(size)))
        run = solve_ivp(rhs, (0.0, orbit.tau), start.ravel(), "DOP853", rtol=tolerance, atol=tolerance)
        return largest_multiplier(run.y[:, -1].reshape(size, size + 1)[:, 1:])
