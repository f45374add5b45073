"""The smallest kick as a nonlinear programme: multiple shooting (Bock and Plitt 1984) solved by Ipopt.

Unknown are the kick, the states at the ends of segments, the time t of escape and the phase theta of the point of the
orbit that is nearest then. With r = (y, y'/Omega)(t) - (Y, Y'/Omega)(theta),

    minimise |kick|^2   subject to   flow from node to node,   |r| = distance,   r . dY/dtheta = 0,   0 <= t <= time.

That theta is stationary does not make it the nearest phase: the farthest one is stationary, too, and with
|r| >= distance no kick at all would do. But of the stationary phases only the nearest one has |r| below the reach of
the orbit (Federer 1959, Theorem 4.8), and the distance must be. Equality loses nothing: a kick that comes farther
within the time has been at the distance before, or is itself farther at t = 0, and then a part of it is at it there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_skin.interrupts import interrupts_deferred
from casadi_skin.optimise.kick.flow import KickedFlow
from casadi_skin.theory.linear import Array

SEGMENT = 8  # steps in a segment, about half a period of the slowest vibration
TOLERANCE = 1e-9
ITERATIONS = 200
SOLVED = "Solve_Succeeded"


@dataclass(frozen=True, eq=False)
class Optimum:
    """Where Ipopt ended: the kick in units of the programme (m,), its norm, time, phase and what is left to be said.

    `kkt` is the largest component of the gradient of the Lagrangian relative to that of the objective, `violation` the
    largest violation of a constraint; `strict` tells that the reduced Hessian is positive definite (from the inertia of
    the last factorisation), so that the point is a strict local minimum.
    """

    kick: Array
    norm: float
    time: float
    phase: float
    kkt: float
    violation: float
    strict: bool
    iterations: int
    words: str

    @property
    def solved(self) -> bool:
        """Whether Ipopt met its tolerance."""
        return self.words == SOLVED


class _Iterations(ca.Callback):  # type: ignore[misc]
    """Hands each iteration of Ipopt on, and keeps what hearing it raises: CasADi would swallow it."""

    def __init__(self, unknowns: int, constraints: int, say: Callable[[int, float, float], None]) -> None:
        ca.Callback.__init__(self)
        self._sizes = {"x": unknowns, "f": 1, "g": constraints, "lam_x": unknowns, "lam_g": constraints, "lam_p": 0}
        self.say, self.count = say, 0
        self.failure: Exception | None = None
        self.construct("iterations")

    def get_n_in(self) -> int:
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._sizes[ca.nlpsol_out(i)])

    def eval(self, arguments: list[ca.DM]) -> list[int]:
        found = dict(zip(ca.nlpsol_out(), arguments, strict=True))
        try:
            self.say(self.count, float(found["f"]), float(ca.norm_inf(found["g"])))
        except Exception as error:
            self.failure = error
        self.count += 1
        return [int(self.failure is not None)]


class KickProgramme:
    """The programme of one flow, distance and basis: a kick is `basis` (2N, m) times m unknowns, its norm theirs.

    `scale` is a size that the smallest kick may have; kicks are in units of it, and each component of a node in units
    of what such kicks do to it at most, linearised: far from the edge that can be millions of what it does to the rest.
    """

    def __init__(
        self, flow: KickedFlow, distance: float, basis: Array, scale: float, say: Callable[[int, float, float], None]
    ) -> None:
        self.flow, self.distance, self.scale = flow, distance, scale
        self.steps = np.diff(np.append(np.arange(0, flow.steps, SEGMENT), flow.steps))
        spread = scale * np.linalg.norm(flow.linear_images(basis)[np.cumsum(self.steps)], axis=2)
        self._units = np.maximum(distance, spread).T
        size, many, m = flow.size, len(self.steps), basis.shape[1]
        kick, scaled = ca.MX.sym("kick", m), ca.MX.sym("nodes", size, many)
        share, phase = ca.MX.sym("share"), ca.MX.sym("phase")
        z, units = ca.vertcat(kick, ca.vec(scaled), share, phase), ca.DM(self._units)
        h, nodes = share * (flow.time / flow.steps), units * scaled
        before = ca.horzcat(flow.start + ca.DM(scale * basis) @ kick, nodes[:, :-1])
        gaps = ca.vec((self._segments(before, h) - nodes) / units)
        point, tangent = flow.loop.symbols(phase)
        away = (flow.shown * nodes[:, -1] - point) / distance
        constraints = ca.vertcat(gaps, ca.sumsqr(away) - 1.0, ca.dot(away, tangent))
        programme = {"x": z, "f": ca.sumsqr(kick), "g": constraints}
        self._heard = _Iterations(z.numel(), constraints.numel(), say)
        self._m, self._last = m, z.numel()
        self._lower, self._upper = np.full(self._last, -np.inf), np.full(self._last, np.inf)
        self._lower[-2], self._upper[-2] = 0.0, 1.0
        options = {
            "print_time": False,
            "error_on_fail": False,
            "show_eval_warnings": False,  # a trial step that runs away is shortened
            "iteration_callback": self._heard,
            "ipopt.print_level": 0,
            "ipopt.sb": "yes",
            "ipopt.tol": TOLERANCE,
            "ipopt.constr_viol_tol": TOLERANCE,
            "ipopt.acceptable_iter": 0,
            "ipopt.max_iter": ITERATIONS,
            "ipopt.nlp_scaling_method": "none",  # unknowns and constraints are of order one
            "ipopt.bound_relax_factor": 0.0,
            "ipopt.bound_push": 1e-4,  # starts are feasible, some at the end of the time: left there
            "ipopt.bound_frac": 1e-4,
            "ipopt.mu_init": 1e-4,
        }
        self._solver = ca.nlpsol("smallest_kick", "ipopt", programme, options)
        gradient, jacobian = ca.gradient(programme["f"], z), ca.jacobian(constraints, z)
        self._conditions = ca.Function("conditions", [z], [gradient, jacobian, constraints])

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

    def solve(self, kick: Array, share: float, phase: float, states: Array) -> Optimum:
        """The optimum from a kick, the states (steps + 1, 2N) of `share` of the time, and a phase near the nearest.

        Raises KeyboardInterrupt after an interruption, and what hearing of an iteration raised.
        """
        nodes = states[np.cumsum(self.steps)] / self._units.T
        z0 = np.concatenate([kick / self.scale, nodes.ravel(), [share, phase]])
        constraints = self._conditions.size1_out(2)
        with interrupts_deferred(end_solver=True):
            self._heard.count, self._heard.failure = 0, None
            found = self._solver(x0=z0, lbx=self._lower, ubx=self._upper, lbg=np.zeros(constraints), ubg=0)
        if self._heard.failure is not None:
            raise self._heard.failure
        stats = self._solver.stats()
        z = np.array(found["x"]).ravel()
        gradient, jacobian, gaps = self._conditions(z)
        lagrangian = gradient + jacobian.T @ found["lam_g"] + found["lam_x"]
        regularised = stats["iterations"]["regularization_size"] if "iterations" in stats else [np.inf]
        return Optimum(
            kick=self.scale * z[: self._m],
            norm=self.scale * float(np.linalg.norm(z[: self._m])),
            time=float(z[-2]) * self.flow.time,
            phase=float(z[-1]),
            kkt=float(ca.norm_inf(lagrangian) / ca.norm_inf(gradient)),
            violation=float(ca.norm_inf(gaps)),
            strict=bool(regularised[-1] == 0.0),
            iterations=int(stats["iter_count"]),
            words=str(stats["return_status"]),
        )
