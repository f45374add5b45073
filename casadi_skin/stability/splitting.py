"""Symplectic splitting of the variational flow: order 6, Runge-Kutta-Nystrom type, 11 stages (Blanes and Moan 2002).

For X'' = J(t) X with J = df/dq along the orbit, kicks V += b h J X and drifts X += a h V alternate; time moves with the
drifts. The map is symplectic to round-off at every step number, so that stable orbits do not acquire instabilities.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from casadi_skin.bvp.problem import Array, OrbitProblem
from casadi_skin.bvp.symmetry import symmetry_class
from casadi_skin.models.ode import OdeModel
from casadi_skin.stability.flow import FlowError, Transition

STEPS = (4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512)
ORDER = 6
EXTRAPOLATION_FACTOR = 4.0  # measured: at most 3.5 over 40 random chains and five pairs of step numbers
ROUND_OFF = 2e-14
STIFFNESS_PHASES = 5


def srkn_coefficients() -> tuple[Array, Array]:
    """Drifts a, shape (11,), and kicks b, shape (12,), of the method called SRKN11b by Blanes and Moan (2002)."""
    b = [0.0414649985182624, 0.198128671918067, -0.0400061921041533, 0.0752539843015807, -0.0115113874206879]
    a = [0.123229775946271, 0.290553797799558, -0.127049212625417, -0.246331761062075, 0.357208872795928]
    b.append(0.5 - sum(b))
    a.append(1.0 - 2.0 * sum(a))
    return np.array(a + a[-2::-1]), np.array(b + b[::-1])


class SplittingMap:
    """Transition matrix of the variational system over a part of the period, in `steps` equal steps.

    Raises ValueError for a model that is not of second order with forces that depend on positions only.
    """

    def __init__(self, model: OdeModel, steps: int) -> None:
        if model.order != 2:
            raise ValueError(f"{model.name}: the splitting needs a model of second order; use cvodes")
        self.model, self.steps = model, steps
        self._drifts, self._kicks = srkn_coefficients()
        # One node at the start of each drift-kick pair; the last kick of a step and the first of the next are one.
        ends = np.concatenate([[0.0], np.cumsum(self._drifts)])
        nodes = (np.arange(steps)[:, None] + ends[1:]).ravel() / steps
        self.fractions = np.concatenate([[0.0], nodes])
        self._function = self._build()

    def _build(self) -> ca.Function:
        model, n, stages = self.model, self.model.size, self._drifts.size
        jacobian = ca.Function("J", [model.state, model.parameters], [ca.jacobian(model.rhs, model.state)])
        state = ca.MX.sym("state", 2 * n, 2 * n)
        q, p, h = ca.MX.sym("q", n, stages), ca.MX.sym("p", model.parameters.numel()), ca.MX.sym("h")
        kicks = self._kicks[1:].copy()
        kicks[-1] += self._kicks[0]  # with the first kick of the next step; the last step gives it back below
        x, v = ca.vertsplit(state, n)
        for i in range(stages):
            x = x + (self._drifts[i] * h) * v
            v = v + (kicks[i] * h) * (jacobian(q[:, i], p) @ x)
        step = ca.Function("step", [state, q, p, h], [ca.vertcat(x, v)])

        q0, q_all = ca.MX.sym("q0", n), ca.MX.sym("q_all", n, stages * self.steps)
        first = self._kicks[0] * h
        identity, zero = ca.MX.eye(n), ca.MX(n, n)
        start = ca.blockcat([[identity, zero], [first * jacobian(q0, p), identity]])
        repeated = (ca.repmat(v, 1, self.steps) for v in (p, h))
        end = step.fold(self.steps)(ca.densify(start), q_all, *repeated)
        x, v = ca.vertsplit(end, n)
        end = ca.vertcat(x, v - first * (jacobian(q_all[:, -1], p) @ x))
        return ca.Function("transition", [q0, q_all, p, h], [end])

    def __call__(self, positions: Array, parameter: float, duration: float) -> Array:
        """Transition matrix over `duration`; `positions` along it at `fractions`, shape (len(fractions), n)."""
        q = positions.T
        return np.array(self._function(q[:, 0], q[:, 1:], parameter, duration / self.steps))


class SplittingFlow:
    """Transition matrices by the splitting at two step numbers, extrapolated (Richardson) to order 8.

    With E the difference between the finer map and the extrapolated one, what is left is about E (omega h)^2, omega^2
    the largest stiffness along the orbit; the step numbers are chosen so that this meets the tolerance. The fraction
    of the period is that of the model's symmetry class. Raises FlowError when the most steps do not suffice.
    """

    def __init__(self, model: OdeModel, tolerance: float) -> None:
        self.model, self.tolerance = model, tolerance
        self.fraction = symmetry_class(model).value
        self._maps: dict[int, SplittingMap] = {}
        jacobian = ca.fabs(ca.jacobian(model.rhs, model.state))
        row_sums = ca.Function("stiffness", [model.state, model.parameters], [ca.mmax(ca.densify(ca.sum2(jacobian)))])
        self._row_sums = row_sums.map(STIFFNESS_PHASES)
        self._rung = 1  # where the last orbit met the tolerance: the next one starts there

    def _map(self, steps: int) -> SplittingMap:
        if steps not in self._maps:
            self._maps[steps] = SplittingMap(self.model, steps)
        return self._maps[steps]

    def _run(self, rung: int, problem: OrbitProblem, z: Array, duration: float) -> Array:
        flow = self._map(STEPS[rung])
        positions = problem.sample(z, 2.0 * np.pi * self.fraction * flow.fractions)
        return flow(positions, float(z[problem.parameter_index]), duration)

    def _stiffness(self, problem: OrbitProblem, z: Array) -> float:
        """Largest absolute row sum of df/dq along the orbit: a softening site is softest where it is farthest out."""
        theta = 2.0 * np.pi * self.fraction * np.linspace(0.0, 1.0, STIFFNESS_PHASES)
        values = self._row_sums(problem.sample(z, theta).T, np.full((1, theta.size), z[problem.parameter_index]))
        return float(np.max(np.array(values)))

    def transition(self, problem: OrbitProblem, z: Array) -> Transition:
        """Transition matrix of (positions, velocities) along the orbit."""
        duration = 2.0 * np.pi * self.fraction / float(z[problem.Omega_index])
        stiffness = self._stiffness(problem, z)
        rung = self._rung
        coarse = self._run(rung - 1, problem, z, duration)
        while True:
            fine = self._run(rung, problem, z, duration)
            correction = (fine - coarse) / ((STEPS[rung] / STEPS[rung - 1]) ** ORDER - 1.0)
            matrix = fine + correction
            scale = float(np.linalg.norm(matrix))
            remainder = EXTRAPOLATION_FACTOR * stiffness * (duration / STEPS[rung]) ** 2
            truncation = remainder * float(np.linalg.norm(correction))
            if truncation <= max(self.tolerance, ROUND_OFF * scale):
                # An error that falls with the eighth power: one rung lower would have done if this is far below.
                self._rung = max(1, rung - 1) if truncation < 0.01 * self.tolerance else rung
                return Transition(matrix, self.fraction, truncation + ROUND_OFF * scale)
            if rung + 1 == len(STEPS) or not np.isfinite(truncation):
                raise FlowError(
                    f"the splitting leaves {truncation:.1e} with {STEPS[rung]} steps; asked: {self.tolerance:.1e}"
                )
            rung, coarse = rung + 1, fine
