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
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from casadi_skin.optimise.kick_flow import KickedFlow
from casadi_skin.optimise.nlp import Limits, Nlp
from casadi_skin.optimise.optimality import optimality
from casadi_skin.solve.iteration_callback import Monitor
from casadi_skin.solve.nlp import SOLVED
from casadi_skin.zero.problem import Array

SEGMENT = 8  # steps in a segment, about half a period of the slowest vibration
ITERATIONS = 200
OPTIONS: Mapping[str, Any] = {
    "ipopt.tol": 1e-9,
    "ipopt.constr_viol_tol": 1e-9,
    "ipopt.nlp_scaling_method": "none",  # unknowns and constraints are of order one
    "ipopt.bound_push": 1e-4,  # starts are feasible, some at the end of the time: left there
    "ipopt.bound_frac": 1e-4,
    "ipopt.mu_init": 1e-4,
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
        return self.words == SOLVED


class KickNlp(Nlp):
    """The programme of one flow, distance and basis: a kick is `basis` (2N, m) times m unknowns, its norm theirs.

    `scale` is a size that the smallest kick may have; kicks are in units of it, and each component of a node in units
    of what such kicks do to it at most, linearised: far from the edge that can be millions of what it does to the rest.
    """

    def __init__(self, flow: KickedFlow, distance: float, basis: Array, scale: float) -> None:
        self.flow, self.distance, self.scale = flow, distance, scale
        self.steps = np.diff(np.append(np.arange(0, flow.steps, SEGMENT), flow.steps))
        spread = scale * np.linalg.norm(flow.linear_images(basis)[np.cumsum(self.steps)], axis=2)
        self._units = np.maximum(distance, spread).T
        size, many, self._kicks = flow.size, len(self.steps), basis.shape[1]
        z = ca.MX.sym("z", self._kicks + size * many + 2)
        kick, share, phase, units = z[: self._kicks], z[-2], z[-1], ca.DM(self._units)
        nodes = units * ca.reshape(z[self._kicks : -2], size, many)
        before = ca.horzcat(flow.start + ca.DM(scale * basis) @ kick, nodes[:, :-1])
        gaps = ca.vec((self._segments(before, share * (flow.time / flow.steps)) - nodes) / units)
        point, tangent = flow.loop.symbols(phase)
        away = (flow.output_scale * nodes[:, -1] - point) / distance
        g = ca.vertcat(gaps, ca.sumsqr(away) - 1.0, ca.dot(away, tangent))
        lower, upper, zero = np.full(z.numel(), -np.inf), np.full(z.numel(), np.inf), np.zeros(g.numel())
        lower[-2], upper[-2] = 0.0, 1.0
        limits = Limits(lower, upper, zero, zero, {"time": np.array([z.numel() - 2])})
        super().__init__(z, ca.sumsqr(kick), g, limits, options={**OPTIONS, "ipopt.max_iter": ITERATIONS})

    def _segments(self, before: ca.MX, h: ca.MX) -> ca.MX:
        """States after each segment, (2N, segments): equal ones in one map, the last by itself if it is shorter."""
        size, states = self.flow.size, ca.MX.sym("states", self.flow.size + 1)
        parts: list[ca.MX] = []
        for count in sorted(set(self.steps.tolist()), reverse=True):
            many = int(np.count_nonzero(self.steps == count))
            moved = self.flow.step.fold(int(count))(states) if count > 1 else self.flow.step(states)
            segment = ca.Function("segment", [states], [moved[:size]]).map(many)
            column = sum(part.shape[1] for part in parts)
            parts.append(segment(ca.vertcat(before[:, column : column + many], ca.repmat(h, 1, many))))
        return ca.horzcat(*parts)

    def optimum(self, start: KickOptimum, states: Array, monitor: Monitor | None = None) -> KickOptimum:
        """The optimum from a kick and the states (steps + 1, 2N) up to its time of escape.

        Raises KeyboardInterrupt after an interruption, and exceptions of the monitor.
        """
        nodes = states[np.cumsum(self.steps)] / self._units.T
        share = start.time / self.flow.time
        z0 = np.concatenate([start.kick / self.scale, nodes.ravel(), [share, start.phase]])
        solution = self.solve(z0, monitor)
        z, found = solution.x, optimality(self, solution)
        kick = self.scale * z[: self._kicks]
        return KickOptimum(
            name=start.name,
            kick=kick,
            norm=float(np.linalg.norm(kick)),
            time=float(z[-2]) * self.flow.time,
            phase=float(z[-1]),
            kkt=found.kkt.largest,
            violation=found.kkt.violation,
            strict=found.curvature > 0,
            iterations=solution.iterations,
            words=solution.words,
        )
