"""The smallest kick as a nonlinear programme: multiple shooting (Bock and Plitt 1984).

Unknown are the kick, the states at the ends of segments, the time t of escape and the phase theta of the point of the
orbit that is nearest then. With r = (y, y'/Omega)(t) - (Y, Y'/Omega)(theta),

    minimise |kick|^2   subject to   flow from node to node,   |r| = distance,   r . dY/dtheta = 0,   0 <= t <= time.

That theta is stationary does not make it the nearest phase: the farthest one is stationary, too, and with
|r| >= distance no kick at all would do. But of the stationary phases only the nearest one has |r| below the reach of
the orbit (Federer 1959, Theorem 4.8), and the distance must be. Equality loses nothing: a kick that comes farther
within the time has been at the distance before, or is itself farther at t = 0, and then a part of it is at it there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from casadi_skin.dynamics.evolve import Splitting
from casadi_skin.follow.closed_curve import Curve, cosine_curve
from casadi_skin.follow.solution import Orbit
from casadi_skin.search.cosine_orbit import CosineOrbit
from casadi_skin.search.kick_flow import ChainForce
from casadi_skin.search.nlp import Nlp, Solution, optimality
from casadi_skin.solve.ipopt import SOLVED_STATUS, Computed
from casadi_skin.zero.problem import Array, Indices

# The flow from a kicked orbit over many steps with exact derivatives, and its distance from the orbit -----------------

STEP_RADIANS = 0.75  # of the fastest linear vibration: against CVODES, 2e-8 of the state in 5 periods (measured)
REACH_PHASES = 720  # of the orbit, between which its reach is sought


def _points(curve: Curve, theta: Array) -> tuple[Array, Array]:
    """Points (y, y'/Omega) of an orbit in units of sqrt(S), and their derivatives by the phase, (len(theta), 2N)."""
    point, tangent = curve.points(theta)
    return point / curve.unit, tangent / curve.unit


def reach(curve: Curve) -> float:
    """Distance below which a point has one nearest point on a closed curve (Federer 1959, Theorem 4.18).

    The infimum over pairs p, q of |q - p|^2 / (2 |part of q - p that is normal to the curve at p|).
    """
    point, tangent = _points(curve, 2.0 * np.pi * np.arange(REACH_PHASES) / REACH_PHASES)
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    smallest = np.inf
    for p, t in zip(point, tangent, strict=True):
        chord = point - p
        square = np.sum(chord**2, axis=1)
        normal = np.linalg.norm(chord - np.outer(chord @ t, t), axis=1)
        smallest = min(smallest, float(np.min(square[normal > 0] / (2.0 * normal[normal > 0]), initial=np.inf)))
    return smallest


@dataclass(frozen=True, eq=False)
class KickedFlow:
    """The flow of a chain from the phase zero of an orbit, kicked or not, over `steps` equal steps up to `time`."""

    orbit: CosineOrbit
    time: float
    steps: int

    @classmethod
    def up_to(cls, orbit: Orbit, time: float) -> KickedFlow:
        """With as many steps as the fastest linear vibration needs."""
        fastest = float(np.sqrt(orbit.model.alpha + 2.0 * (1.0 + orbit.model.coupling)))
        return cls(CosineOrbit.of(orbit), time, max(4, int(np.ceil(time * max(fastest, orbit.Omega) / STEP_RADIANS))))

    def __reduce__(self) -> tuple[type[KickedFlow], tuple[CosineOrbit, float, int]]:
        return KickedFlow, (self.orbit, self.time, self.steps)  # another process builds its own functions

    @property
    def size(self) -> int:
        """Number of components of the state, 2N."""
        return 2 * int(self.orbit.model.sites)

    @cached_property
    def output_scale(self) -> Array:
        """Factors that make (y, y'/Omega)/sqrt(S) of a state, shape (2N,)."""
        rho = self.orbit.model.rho
        return np.concatenate([rho, rho / self.orbit.Omega])

    @cached_property
    def curve(self) -> Curve:
        """The orbit as the closed curve of (y, y'/Omega), in units of sqrt(S), that distances are measured from."""
        return cosine_curve(self.orbit)

    def symbols(self, theta: ca.MX) -> tuple[ca.MX, ca.MX]:
        """A point of the curve and its derivative by the phase in CasADi symbols, (2N,) each."""
        c, order = ca.DM(self.orbit.cosines.T / self.curve.unit), ca.DM(2.0 * np.arange(self.orbit.harmonics) + 1.0)
        cosine, sine = ca.cos(theta * order), ca.sin(theta * order)
        y, dy, ddy = c @ cosine, -(c @ (sine * order)), -(c @ (cosine * order**2))
        return ca.vertcat(y, dy), ca.vertcat(dy, ddy)

    @cached_property
    def start(self) -> Array:
        """State of the orbit at phase zero, shape (2N,)."""
        chain = self.orbit.model
        return np.concatenate([self.orbit.profile / (np.sqrt(self.orbit.S) * chain.rho), np.zeros(chain.sites)])

    @cached_property
    def _splitting(self) -> Splitting:
        return Splitting(self.orbit.model.gauge_model(), np.array([self.orbit.model.g * self.orbit.S]))

    @cached_property
    def force(self) -> ChainForce:
        """That of the gauge in units of sqrt(S)."""
        chain = self.orbit.model
        return ChainForce(2.0 + chain.alpha, chain.coupling, chain.g * self.orbit.S * np.asarray(chain.weights))

    def run(self, kicks: Array) -> Array:
        """States at all steps from kicks (many, 2N), shape (many, steps + 1, 2N); not finite where one runs away."""
        states, counts = np.empty((len(kicks), self.steps + 1, self.size)), np.arange(self.steps + 1).clip(max=1)
        for each, kick in zip(states, kicks, strict=True):
            each[0] = self.start + kick
            self._splitting.chain(each, counts, self.time / self.steps)
        return states

    def distances(self, states: Array) -> Array:
        """Distance of states (..., 2N) from the orbit, shape (...), in the curve's unit; inf for nan."""
        rows = states.reshape(-1, self.size)
        finite = np.all(np.abs(rows) < 1e100, axis=1)
        found = np.full(len(rows), np.inf)
        found[finite] = self.curve.distances(self.curve.unit * self.output_scale * rows[finite])
        return found.reshape(states.shape[:-1])

    def nearest_phase(self, state: Array) -> float:
        """Phase of the orbit nearest to a state (2N,), among PHASES."""
        theta = 2.0 * np.pi * np.arange(REACH_PHASES) / REACH_PHASES
        points, _ = _points(self.curve, theta)
        return float(theta[np.argmin(np.linalg.norm(points - self.output_scale * state, axis=1))])

    def first_to_escape(self, direction: Array, distance: float, near: float) -> tuple[float, int] | None:
        """Smallest multiple of a direction (2N,) that comes to the distance, and the step at which it does.

        Sizes from 1/30 to 1000 times `near` are tried, ever closer ones around the first that escapes; None if none.
        """
        sizes = near * np.geomspace(1 / 30, 1000, 60)
        for _ in range(3):
            farthest = self.distances(self.run(sizes[:, None] * direction))
            escapes = np.max(farthest, axis=1) >= distance
            if not np.any(escapes):
                return None
            first = int(np.argmax(escapes))
            found = float(sizes[first]), int(np.argmax(farthest[first] >= distance))
            sizes = np.linspace(sizes[first - 1] if first else 0.0, sizes[first], 20)
        return found

    def linear_images(self, directions: Array) -> Array:
        """Images of the columns of `directions` (2N, m) under the linearised flow, shape (steps + 1, 2N, m)."""
        states, images = self.run(np.zeros((1, self.size)))[0, :-1], [directions]
        for derivative in self.force.segments(np.ones(self.steps, dtype=np.int64), self.time / self.steps, states)[1]:
            images.append(derivative[:, :-1] @ images[-1])
        return np.array(images)

    def linear_gains(self, directions: Array) -> tuple[Array, Array, Array]:
        """Largest growth of distance from kicks in the span of `directions` (2N, m), linearised, at each step.

        Returns the times (steps + 1,), the k = min(m, 2) largest singular values (steps + 1, k) of the part that is
        normal to the orbit in (y, y'/Omega)/sqrt(S), and their right singular vectors (steps + 1, k, m).
        """
        t = np.linspace(0.0, self.time, self.steps + 1)
        tangents = _points(self.curve, self.orbit.Omega * t)[1]
        tangents /= np.linalg.norm(tangents, axis=1)[:, None]
        seen = self.output_scale[:, None] * self.linear_images(directions)
        normal = seen - tangents[:, :, None] * (tangents[:, None] @ seen)
        _, values, right = np.linalg.svd(normal, full_matrices=False)
        return t, np.asarray(values[:, :2]), np.asarray(right[:, :2])


SEGMENT_STEPS = 8  # steps in a segment, about half a period of the slowest vibration
MOST_ITERATIONS = 200
IPOPT_OPTIONS: Mapping[str, Any] = {
    "ipopt.tol": 1e-9,
    "ipopt.constr_viol_tol": 1e-9,
    "ipopt.nlp_scaling_method": "none",  # unknowns and constraints are of order one
    "ipopt.bound_push": 1e-4,  # starts are feasible, some at the end of the time: left there
    "ipopt.bound_frac": 1e-4,
    "ipopt.mu_init": 1e-4,
    "no_nlp_grad": True,  # the gradient of the Lagrangian, which is not used
}


@dataclass(frozen=True, eq=False)
class KickOptimum:
    """A local optimum, or where Ipopt ended in place of one.

    Attributes:
        name: the start that led there.
        kick: in a result (2N,) positions and velocities in physical coordinates; in a search its unknowns (m,).
        norm: its norm.
        time: time of escape.
        phase: of the nearest point of the orbit then.
        kkt: largest residual of the conditions of Karush, Kuhn and Tucker.
        violation: largest violation of a constraint, relative to its terms.
        strict: whether the Hessian is positive definite on the constraints, so that this is a strict local minimum.
        iterations: of Ipopt.
        words: Ipopt's return status.
    """

    name: str
    kick: Array
    norm: float
    time: float
    phase: float
    kkt: float = np.inf
    violation: float = np.inf
    strict: bool = False
    iterations: int = 0
    words: str = "not solved"

    @property
    def solved(self) -> bool:
        """Whether Ipopt met its tolerance."""
        return self.words == SOLVED_STATUS


class KickNlp(Nlp):
    """The programme of one flow, distance and basis: a kick is `basis` (2N, m) times m unknowns, its norm theirs.

    `scale` is a size that the smallest kick may have; kicks are in units of it, and each component of a node in units
    of what such kicks do to it at most, linearised: far from the edge that can be millions of what it does to the rest.
    """

    def __init__(self, flow: KickedFlow, distance: float, basis: Array, scale: float) -> None:
        self.flow, self.basis, self.scale = flow, basis, scale
        self.steps = np.diff(np.append(np.arange(0, flow.steps, SEGMENT_STEPS), flow.steps))
        spread = scale * np.linalg.norm(flow.linear_images(basis)[np.cumsum(self.steps)], axis=2)
        self._units, self._kicks = np.maximum(distance, spread), basis.shape[1]
        node, phase, lam = ca.MX.sym("node", flow.size), ca.MX.sym("phase"), ca.MX.sym("lam", 2)
        point, tangent = flow.symbols(phase)
        away, at = (flow.output_scale * self._units[-1] * node - point) / distance, ca.vertcat(node, phase)
        end = ca.vertcat(ca.sumsqr(away) - 1.0, ca.dot(away, tangent))
        self._end = ca.Function("end", [at], [end, ca.densify(ca.jacobian(end, at))])
        self._end_hessian = ca.Function("hessian", [at, lam], [ca.triu(ca.hessian(ca.dot(lam, end), at)[0])])
        z = ca.MX.sym("z", self._kicks + self._units.size + 2)
        dense = ca.Sparsity.dense(self._units.size + 2, 1)
        self._flowing = Computed("g", {"x": z.numel()}, {"g": dense}, lambda x: [self._rows(x)[0]])
        options = {**IPOPT_OPTIONS, "ipopt.max_iter": MOST_ITERATIONS}
        bounds, place = {"time": ([z.numel() - 2], 0.0, 1.0)}, ca.vertcat(z[: self._kicks], z[-2])
        super().__init__(z, ca.sumsqr(z[: self._kicks]), self._flowing(z), bounds, options=options, place=place)

    def _segments(self, x: Array, multipliers: Array | None = None) -> tuple[Array, Array, Array | None]:
        """The gaps, and derivatives by the states before segments and by the share of the time, of scaled gaps."""
        flow, units = self.flow, self._units
        h, nodes = x[-2] * flow.time / flow.steps, units * x[self._kicks : -2].reshape(units.shape)
        before = np.vstack([flow.start + self.scale * self.basis @ x[: self._kicks], nodes[:-1]])
        given = None if multipliers is None else multipliers[: units.size].reshape(units.shape) / units
        after, first, second = flow.force.segments(self.steps, h, before, given)
        last = flow.time / flow.steps * (np.arange(flow.size + 1) == flow.size) + (np.arange(flow.size + 1) < flow.size)
        if second is not None:
            second *= last[:, None] * last
        return (after - nodes) / units, first * last / units[:, :, None], second

    def _rows(self, x: Array) -> tuple[Array, Array]:
        """Constraints, and the non-zeros of their derivatives in the order of `_of_jacobian`."""
        gaps, first, _ = self._segments(x)
        end, slope = (np.array(each) for each in self._end(np.append(x[-2 - self.flow.size : -2], x[-1])))
        starts, states = self.scale * first[0, :, :-1] @ self.basis, first[1:, :, :-1] * self._units[:-1, None]
        parts = starts, states, -np.ones(gaps.size), first[:, :, -1], slope
        return np.append(gaps, end), np.concatenate([part.ravel() for part in parts])

    def _curved(self, x: Array, lam_f: float, lam_g: Array) -> Array:
        """Second derivatives of the Lagrangian in the order of `_of_hessian`."""
        second, units, size = self._segments(x, lam_g)[2], self._units[:-1], self.flow.size
        assert second is not None
        into, end = self.scale * self.basis, self._end_hessian(np.append(x[-2 - size : -2], x[-1]), lam_g[-2:])
        kicks = into.T @ second[0, :size, :size] @ into + 2.0 * lam_f * np.eye(self._kicks)
        states = second[1:, :size, :size] * units[:, :, None] * units[:, None]
        parts = kicks[np.triu_indices(self._kicks)], states[:, *np.triu_indices(size)], second[0, :size, -1] @ into
        more = second[1:, :size, -1] * units, np.sum(second[:, -1, -1]), np.array(end.nonzeros())
        return np.concatenate([np.ravel(part) for part in (*parts, *more)])

    @cached_property
    def _of_jacobian(self) -> tuple[ca.Sparsity, Indices]:
        """The pattern of the Jacobian, and the order of its non-zeros among `_rows`."""
        kicks, rows = np.arange(self._kicks), np.arange(self._units.size).reshape(self._units.shape)
        nodes, share, end = self._kicks + rows, self.size - 2, rows.size + np.arange(2)
        at = np.append(nodes[-1], share + 1)
        pairs = (rows[0][:, None], kicks), (rows[1:, :, None], nodes[:-1, None]), (rows, nodes), (rows, share)
        return _pattern((rows.size + 2, self.size), *pairs, (end[:, None], at))

    @cached_property
    def _of_hessian(self) -> tuple[ca.Sparsity, Indices]:
        """The pattern of the upper half of the Hessian, and the order of its non-zeros among `_curved`."""
        kicks, nodes = np.arange(self._kicks), self._kicks + np.arange(self._units.size).reshape(self._units.shape)
        share, (a, b) = self.size - 2, np.triu_indices(self.flow.size)
        at, (row, column) = np.append(nodes[-1], share + 1), self._end_hessian.sparsity_out(0).get_triplet()
        pairs = np.triu_indices(self._kicks), (nodes[:-1, a], nodes[:-1, b]), (kicks, share), (nodes[:-1], share)
        return _pattern((self.size, self.size), *pairs, (share, share), (at[row], at[column]))

    @cached_property
    def _constraints(self) -> ca.Function:
        pattern, order = self._of_jacobian

        def values(x: Array, _: Array) -> list[Array]:
            g, nonzeros = self._rows(x)
            return [g, nonzeros[order]]

        results = {"g": ca.Sparsity.dense(self._units.size + 2, 1), "jac_g_x": pattern}
        return Computed("jac_g", {"x": self.size, "p": 0}, results, values)

    @cached_property
    def _hessian(self) -> ca.Function:
        pattern, order = self._of_hessian
        arguments = {"x": self.size, "p": 0, "lam_f": 1, "lam_g": self._units.size + 2}

        def values(x: Array, _: Array, lam_f: Array, lam_g: Array) -> list[Array]:
            return [self._curved(x, float(lam_f[0]), lam_g)[order]]

        return Computed("hess_lag", arguments, {"triu_hess_gamma_x_x": pattern}, values)

    def shown(self, f: float) -> float:
        """The norm in place of its square in units of `scale`."""
        return float(np.sqrt(self.flow.orbit.S) * self.scale * np.sqrt(f))

    def packed(self, kick: Array, time: float) -> Array:
        """Unknowns of a kick (m,) that is at the distance after a time."""
        states = replace(self.flow, time=time).run((self.basis @ kick)[None])[0]
        nodes, phase = states[np.cumsum(self.steps)] / self._units, self.flow.nearest_phase(states[-1])
        return np.concatenate([kick / self.scale, nodes.ravel(), [time / self.flow.time, phase]])

    def optimum(self, name: str, solution: Solution, words: str = "") -> KickOptimum:
        """Where Ipopt ended, from the start of a name; `words` in place of its own."""
        kick, found = self.scale * solution.x[: self._kicks], optimality(self, solution)
        return KickOptimum(
            name, kick, norm=float(np.linalg.norm(kick)), time=float(solution.x[-2]) * self.flow.time,
            phase=float(solution.x[-1]), kkt=max(found.kkt, found.violation), violation=found.violation,
            strict=found.curvature > 0, iterations=solution.iterations, words=words or solution.words,
        )  # fmt: skip


def _pattern(shape: tuple[int, int], *pairs: tuple[Any, Any]) -> tuple[ca.Sparsity, Indices]:
    """The sparsity of entries at rows and columns, and their order in it."""
    both = [np.broadcast_arrays(row, column) for row, column in pairs]
    rows, columns = (np.concatenate([each[k].ravel() for each in both]) for k in (0, 1))
    order = np.lexsort((rows, columns))
    ends = np.searchsorted(columns[order], np.arange(shape[1] + 1))
    return ca.Sparsity(*shape, ends.tolist(), rows[order].tolist()), order
