"""The family followed by JaxCont, on odd cosines collocated on a quarter of the period.

    q_n(theta) = sum_k a_nk cos((2k - 1) theta),  -Omega^2 (2k - 1)^2 a_nk -> forces, at theta_j = (j - 1/2) pi / (2K)
    sum_n w_n q_n(0)^2 = 1;  unknowns a and Omega, parameter S

JaxCont's own periodic orbits are dense collocation over the period with every state, 4,000 unknowns here; its
continuation takes any equations, so it is given those of this package: 24 K + 1 unknowns, derivatives by JAX, LAPACK.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from typing import Any

import numpy as np
from family_case import Array, Family, FamilyCase


@dataclass(frozen=True)
class JaxSettings:
    """Harmonics, longest step, aim of Newton's method in the residual."""

    harmonics: int = 8
    longest: float = 0.5
    tolerance: float = 1e-7


# Found by trying: 7 harmonics leave 8e-8 in Omega; at 1e-8 steps are rejected, round-off of the residual being near
BEST = JaxSettings()
STEPS = 40  # most of one call


def missing() -> str:
    """What is absent, as one line; empty if nothing is."""
    return "" if importlib.util.find_spec("jaxcont") else "JaxCont: needs jaxcont (pip install jaxcont)"


class JaxContWalk:
    """The family by `jaxcont.continuation`, in as many calls as there are values of S asked for."""

    def __init__(self, case: FamilyCase, settings: JaxSettings = BEST) -> None:
        import jax
        import jax.numpy as jnp
        from jaxcont.core.scan_continuation import pseudo_arclength_scan
        from jaxcont.solvers.implicit import differentiable_root

        jax.config.update("jax_enable_x64", True)
        self.case, self.settings, self._scan = case, settings, pseudo_arclength_scan
        n, count, chain = case.sites, settings.harmonics, case.chain
        odd = 2.0 * np.arange(count) + 1.0
        theta = (np.arange(count) + 0.5) * np.pi / (2 * count)
        values = jnp.asarray(np.cos(odd[:, None] * theta))
        squares, weights = jnp.asarray(odd**2), jnp.asarray(chain.weights)

        def residual(u: Any, S: Any) -> Any:
            a, Omega = u[:-1].reshape(n, count), u[-1]
            q = a @ values
            neighbours = jnp.zeros_like(q).at[1:].add(q[:-1]).at[:-1].add(q[1:])
            force = (2.0 + chain.alpha) * q - chain.coupling * neighbours + chain.g * S * weights[:, None] * q**3
            norm = jnp.sum(weights * jnp.sum(a, axis=1) ** 2) - 1.0
            return jnp.concatenate([(force - Omega**2 * (a * squares) @ values).ravel(), norm[None]])

        self._along = residual
        aim = settings.tolerance
        self._root = jax.jit(lambda u, S: differentiable_root(residual, u, S, tol=aim, max_iter=10))
        self._start = np.zeros(n * count + 1)
        self._start[:-1].reshape(n, count)[:, 0], self._start[-1] = case.start, case.omega

    def points(self) -> tuple[Array, Array]:
        """S and unknowns of all points; S is exact where points were asked for."""
        settings, S, states = self.settings, [0.0], [self._start]
        for wanted in self.case.at:
            scan = self._scan(
                self._along, states[-1], S[-1], wanted, 0.1, 1e-5, settings.longest, settings.tolerance, STEPS, 9
            )
            count = int(scan.n_valid)
            found, at = np.asarray(scan.params)[:count], np.asarray(scan.states)[:count]
            part = (wanted - found[-2]) / (found[-1] - found[-2])
            before = (found > S[-1] + 1e-9) & (found < wanted - 1e-9)
            S += [*found[before], wanted]
            states += [*at[before], np.asarray(self._root(at[-2] + part * (at[-1] - at[-2]), wanted))]
        return np.array(S), np.array(states)

    def family(self) -> Family:
        """Follow the family from its start."""
        S, states = self.points()
        return Family(S, states[:, -1])
