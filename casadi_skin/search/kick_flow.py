"""Segments of a chain's flow by the splitting, with the derivatives that a programme of shooting needs.

A step h of q'' = f(q), f(q) = -stiffness q + coupling (left + right) - cubic q^3 of a chain in the gauge, are kicks
q' += b_k h f(q) and drifts q += a_k h q' between them. Z and U are the derivatives of q and q' by (q, q') before and by
h, (n, 2n + 1) each; p_k and r_k the adjoints of q' behind a kick and of q behind a drift. With A = df/dq the second
derivative of multipliers times (q, q') behind all is

    sum_k  Z' diag(b_k h p_k f''(q)) Z  +  e m' + m e',   m = sum_k  Z' b_k A p_k + (a_k U)' r_k,

e the unit vector of h.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from casadi_skin.native import kernels
from casadi_skin.native import segments as compiled
from casadi_skin.stability.flows import KicksAndDrifts
from casadi_skin.zero.problem import Array, Indices


@dataclass(frozen=True, eq=False)
class ChainForce:
    """Stiffness, coupling and cubic terms, (n,), of a chain."""

    stiffness: float
    coupling: float
    cubic: Array

    def times(self, q: Array, factor: float, z: Array) -> Array:
        """A z with a factor of 3, and f(q) with a factor of 1 and z = q; z is (n,) or (n, columns)."""
        result = -((self.stiffness + factor * self.cubic * q**2) * z.T).T
        result[1:] += self.coupling * z[:-1]
        result[:-1] += self.coupling * z[1:]
        return result

    def segments(
        self, counts: Indices, h: float, states: Array, multipliers: Array | None = None
    ) -> tuple[Array, Array, Array | None]:
        """So many steps h from each of the states, (segments, 2n).

        Returns the states behind them, their derivatives by the state before and h, (segments, 2n, 2n + 1), and the
        second derivatives of `multipliers`, (segments, 2n), times these, (segments, 2n + 1, 2n + 1), if there are any.
        """
        if kernels():
            one = KicksAndDrifts.of(1)
            data = (self.stiffness, self.coupling, self.cubic), counts, h, np.ascontiguousarray(states)
            given = None if multipliers is None else np.ascontiguousarray(multipliers)
            return compiled((one.kicks, one.drifts), *data, given)
        none = [None] * len(states)
        found = [
            self._segment(*each, h)
            for each in zip(counts, states, none if multipliers is None else multipliers, strict=True)
        ]
        after, jacobians, hessians = zip(*found, strict=True)
        return np.array(after), np.array(jacobians), None if multipliers is None else np.array(hessians)

    def _segment(
        self, count: int, state: Array, multipliers: Array | None, h: float
    ) -> tuple[Array, Array, Array | None]:
        """The same of one segment."""
        sequence, n = KicksAndDrifts.of(int(count)), state.size // 2
        b, a = sequence.kicks, np.append(sequence.drifts, 0.0)
        q, v = np.empty((b.size, n)), np.empty((b.size, n))
        z, u = np.eye(n, 2 * n + 1), np.eye(n, 2 * n + 1, n)
        along, x, y = np.empty((b.size, 2, n, 2 * n + 1)), state[:n], state[n:]
        for k in range(b.size):
            q[k] = x
            along[k, 0] = z
            force = self.times(x, 1.0, x)
            y = v[k] = y + b[k] * h * force
            u = u + b[k] * h * self.times(x, 3.0, z)
            u[:, -1] += b[k] * force
            x, z = x + a[k] * h * y, z + a[k] * h * u
            z[:, -1] += a[k] * y
            along[k, 1] = u
        after, jacobian = np.append(x, y), np.vstack([z, u])
        if multipliers is None:
            return after, jacobian, None
        of_q, of_v = multipliers[:n], multipliers[n:]
        hessian, mixed = np.zeros((2 * n + 1, 2 * n + 1)), np.zeros(2 * n + 1)
        for k in reversed(range(b.size)):
            z, u = along[k]
            mixed += a[k] * of_q @ u
            of_v = of_v + a[k] * h * of_q
            change = b[k] * self.times(q[k], 3.0, of_v)
            mixed += change @ z
            of_q = of_q + h * change
            hessian -= z.T @ ((6.0 * b[k] * h * of_v * self.cubic * q[k])[:, None] * z)
        hessian[:, -1] += mixed
        hessian[-1] += mixed
        return after, jacobian, hessian
