"""The smallest kick that takes a linearly stable breather away within a given time.

A breather is taken away when its phase-aligned distance (`dynamics.distance_from_orbit`) comes to a given fraction of
it. Kerswell, Pringle and Willis (2014) review such minimal seeds in fluids. `kick_programme` states the problem;
here its starts are chosen, its optima sorted and compared with the kick of the paper (Fig. 6b) and with what linear
transient growth (Trefethen and Embree 2005, chapter 14) makes of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from casadi_skin.bvp.problem import Indices
from casadi_skin.optimise.kick.arguments import check, check_processes, kicked_sites
from casadi_skin.optimise.kick.flow import KickedFlow
from casadi_skin.optimise.kick.nlp import Optimum
from casadi_skin.optimise.kick.parallel import in_processes
from casadi_skin.optimise.kick.search import KickProgress, KickSearch, directions
from casadi_skin.optimise.kick.verify import Escape, escape, sampled, size_to_escape
from casadi_skin.orbits.orbit import Orbit
from casadi_skin.theory.linear import Array

REACH_SHARE = 0.99  # of the orbit's reach, which is known on a grid of phases
GAIN_STEPS = 8  # for each of the flow's: the gain swings twice a period, and its peak is missed by up to 0.01 %


@dataclass(frozen=True, eq=False)
class LocalOptimum:
    """One kick (2N,) of positions and velocities in physical coordinates, its norm and time of escape.

    `name` tells the start that led there, `optimum` how Ipopt ended.
    """

    name: str
    kick: Array
    norm: float
    time: float
    optimum: Optimum


@dataclass(frozen=True, eq=False)
class SmallestKick:
    """The smallest kick found; dimensionless.

    `distance` is the fraction asked for and `reached` what CVODES gives at `escape_time`. `linear_norm` is the norm
    that linear transient growth predicts, `far_end_norm` that of the displacement of the far end alone which
    escapes within the same time, at `far_end_time`. `optima` are all local optima, ascending; the first is this one.
    What an interruption left undone of these comparisons is nan.
    """

    orbit: Orbit
    time: float
    distance: float
    norm_name: str
    optima: tuple[LocalOptimum, ...]
    reached: float
    linear_norm: float
    linear_time: float
    linear_kick: Array
    far_end_size: float
    far_end_norm: float
    far_end_time: float
    interrupted: bool
    tried: int

    @property
    def best(self) -> LocalOptimum:
        """The optimum of least norm."""
        return self.optima[0]

    @property
    def displacements(self) -> Array:
        """What is added to the orbit's displacements at t = 0, shape (sites,)."""
        return self.best.kick[: self.orbit.chain.sites]

    @property
    def velocities(self) -> Array:
        """The velocities given at t = 0, where the orbit has none, shape (sites,)."""
        return self.best.kick[self.orbit.chain.sites :]

    @property
    def norm(self) -> float:
        """Norm of the kick: Euclidean, or of the energy sqrt(|eta'|^2 + eta L eta) of the gauge."""
        return self.best.norm

    @property
    def escape_time(self) -> float:
        """When the distance is reached."""
        return self.best.time

    @property
    def kkt(self) -> float:
        """Largest component of the gradient of the Lagrangian relative to that of the objective."""
        return self.best.optimum.kkt

    @property
    def converged(self) -> bool:
        """Whether the kick is a local optimum, not just one that escapes."""
        return self.best.optimum.solved

    @property
    def far_end_kick(self) -> Array:
        """The kick of the paper's Fig. 6(b), a displacement of the far end, at the size that escapes, shape (2N,)."""
        return self.far_end_size * _far_end(self.orbit)

    @cached_property
    def status(self) -> str:
        """What was found and how far it is to be trusted, in a sentence."""
        o = self.best.optimum
        kind = "strict local minimum" if o.strict else "stationary point whose curvature is not checked"
        if self.converged:
            words = f"{kind} (KKT residual {o.kkt:.1e}, violation {o.violation:.1e}), least of {len(self.optima)} found"
            words += f" from {self.tried} starts; that it is the global one is not proved"
        else:
            words = f"a kick that escapes, the least of those that the search started from; no optimum ({o.words})"
        end = "the kick itself is that far" if self.escape_time < 1e-6 * self.time else "inside the time allowed"
        if self.escape_time > (1 - 1e-6) * self.time:
            end = "at the end of the time allowed"
        words += f"; distance {self.reached:.6g}" if np.isfinite(self.reached) else "; not yet compared with CVODES"
        words += f" at t = {self.escape_time:.6g}, {end}"
        return f"interrupted: {words}" if self.interrupted else words

    def evolution(self, kick: Array | None = None) -> Escape:
        """Distance against time up to the time allowed by CVODES, of this kick or another (2N,)."""
        return escape(self.orbit, self.best.kick if kick is None else kick, sampled(self.orbit, self.time))


def smallest_kick(
    orbit: Orbit,
    time: float,
    distance: float = 0.5,
    norm: str = "physical",
    at: int | Iterable[int] | None = None,
    *,
    starts: int = 8,
    seed: int = 0,
    progress: Callable[[KickProgress], None] | None = None,
    workers: int = 1,
    executor: Executor | None = None,
) -> SmallestKick:
    """The kick of least norm at phase zero whose distance from the orbit comes to `distance` at a time <= `time`.

    `distance` is relative to ||y(0)||, below the orbit's reach (about 1), where the nearest phase is unique. `norm` is
    that of (positions, velocities), or "energy": the root of twice the quadratic part of the Hamiltonian of the gauge.
    `at` are the sites that may be kicked, counted from 1, all by default. Of the `starts`, the first are linear
    optima and the far end, the others random of a `seed`; `workers` processes or an `executor` of processes share them.
    An interruption ends the search with the best so far. Raises ValueError and TypeError for arguments out of range or
    an orbit that is not linearly stable, KickError where nothing is found.
    """
    check(orbit, time, distance, norm, starts)
    check_processes(workers, executor)
    sites = kicked_sites(orbit, at)
    flow = KickedFlow.up_to(orbit, float(time))
    if not distance < REACH_SHARE * flow.loop.reach:
        raise ValueError(
            f"distance: given {distance!r}; accepted: below {REACH_SHARE * flow.loop.reach:.4g}, within which the "
            "nearest phase of this orbit is unique"
        )
    basis, S = _basis(orbit, norm, sites), float(np.sqrt(orbit.S))
    t, gains, vectors = replace(flow, steps=GAIN_STEPS * flow.steps).linear_gains(basis)
    peak = int(np.argmax(gains[:, 0]))
    scale = float(distance / gains[peak, 0])
    far = _far_end(orbit)
    along_far = np.asarray(np.linalg.lstsq(basis, far / np.tile(orbit.chain.rho, 2), rcond=None)[0], dtype=float)
    named = directions(along_far, gains, vectors, starts, seed)
    search = KickSearch(flow, distance, basis, scale, len(named), progress)
    elsewhere = executor is not None or min(workers, len(named)) > 1
    optima, interrupted = search.from_all(named, in_processes(search, named, workers, executor) if elsewhere else None)
    best, reached, optima = search.verified(optima)
    try:
        far_size, far_time = size_to_escape(orbit, far, float(time), distance)
    except KeyboardInterrupt:
        far_size, far_time, interrupted = np.nan, np.nan, True

    def physical(kick: Array) -> Array:
        return np.asarray(S * np.tile(orbit.chain.rho, 2) * (basis @ kick))

    listed = tuple(LocalOptimum(n, physical(o.kick), S * o.norm, o.time, o) for n, o in (best, *optima))
    return SmallestKick(
        orbit=orbit,
        time=float(time),
        distance=float(distance),
        norm_name=norm,
        optima=listed,
        reached=reached,
        linear_norm=S * scale,
        linear_time=float(t[peak]),
        linear_kick=physical(scale * vectors[peak, 0]),
        far_end_size=far_size,
        far_end_norm=far_size * kick_norm(orbit, far, norm),
        far_end_time=far_time,
        interrupted=interrupted or search.interrupted,
        tried=search.tried,
    )


def kick_norm(orbit: Orbit, kick: Array, norm: str = "physical") -> float:
    """Norm of a kick (2N,): Euclidean, or "energy", sqrt(|eta'|^2 + eta L eta) of its image eta in the gauge."""
    if norm == "physical":
        return float(np.linalg.norm(kick))
    e = kick / np.tile(orbit.chain.rho, 2)
    n = orbit.chain.sites
    return float(np.sqrt(e[:n] @ _stiffness(orbit) @ e[:n] + e[n:] @ e[n:]))


# The norm ------------------------------------------------------------------------------------------------------------


def _far_end(orbit: Orbit) -> Array:
    """A unit displacement of the end opposite to the edge that the modes lean to, shape (2N,)."""
    unit = np.zeros(2 * orbit.chain.sites)
    unit[int(np.argmin(orbit.chain.log_rho))] = 1.0
    return unit


def _stiffness(orbit: Orbit) -> Array:
    """L of the gauge, shape (sites, sites)."""
    chain = orbit.chain
    off = np.full(chain.sites - 1, -chain.coupling)
    return np.diag(np.full(chain.sites, 2.0 + chain.alpha)) + np.diag(off, 1) + np.diag(off, -1)


def _basis(orbit: Orbit, norm: str, sites: Indices) -> Array:
    """Kicks of the gauge, shape (2N, 2 sites), orthonormal in the norm asked for: a kick is `basis` times unknowns."""
    n = orbit.chain.sites
    moved = np.eye(n)[:, sites]
    if norm == "physical":
        positions = velocities = moved / orbit.chain.rho[:, None]
    else:
        factor = np.linalg.cholesky(moved.T @ _stiffness(orbit) @ moved)
        positions, velocities = moved @ np.linalg.inv(factor).T, moved
    zero = np.zeros_like(moved)
    return np.block([[positions, zero], [zero, velocities]])
