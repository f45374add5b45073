"""The smallest kick that takes a linearly stable breather away within a given time.

A breather is taken away when its phase-aligned distance (`dynamics.distance_from_orbit`) comes to a given fraction of
it. Kerswell, Pringle and Willis (2014) review such minimal seeds in fluids. `kick.nlp` states the problem; here its
starts are chosen, its optima sorted and compared with the kick of the paper (Fig. 6b) and with linear transient growth
(Trefethen and Embree 2005, chapter 14).
"""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from casadi_skin.follow.orbit import Orbit
from casadi_skin.lattice.chain import Chain
from casadi_skin.model.result import Result
from casadi_skin.optimise.kick_arguments import check, kicked_sites
from casadi_skin.optimise.kick_flow import KickedFlow
from casadi_skin.optimise.kick_nlp import KickOptimum
from casadi_skin.optimise.kick_search import (
    KickError,
    KickOutcome,
    KickSearch,
    KickStart,
    directions,
    distinct,
    verified,
)
from casadi_skin.optimise.kick_verify import Escape, escape, sampled, size_to_escape
from casadi_skin.runs.processes import Report, Runner
from casadi_skin.zero.problem import Array, Indices

REACH_SHARE = 0.99  # of the orbit's reach, which is known on a grid of phases
GAIN_STEPS = 8  # for each of the flow's: the gain swings twice a period, and its peak is missed by up to 0.01 %


@dataclass(frozen=True, eq=False)
class SmallestKick(Result):
    """The smallest kick of a search; dimensionless. After an interruption the comparisons that are missing are nan.

    Attributes:
        orbit, time, distance, norm_name: the arguments.
        optima: all local optima, ascending; the first is this one.
        reached: the distance that CVODES gives at `escape_time`.
        linear_norm, linear_time, linear_kick: the kick that linear transient growth predicts.
        far_end_size: displacement of the far end alone that escapes within the same time; `far_end_norm` is its norm,
            `far_end_time` the time of its escape.
        interrupted: whether an interruption ended the search.
        tried: number of starts that have ended.
    """

    orbit: Orbit
    time: float
    distance: float
    norm_name: str
    optima: tuple[KickOptimum, ...]
    reached: float
    linear_norm: float
    linear_time: float
    linear_kick: Array
    far_end_size: float
    far_end_norm: float
    far_end_time: float
    interrupted: bool
    tried: int

    def __repr__(self) -> str:
        return f"<SmallestKick: norm {self.norm:.10g}; {self.status}>"

    @property
    def best(self) -> KickOptimum:
        """The optimum of least norm."""
        return self.optima[0]

    @property
    def displacements(self) -> Array:
        """Change of the orbit's displacements at t = 0, shape (sites,)."""
        return self.best.kick[: self.orbit.model.sites]

    @property
    def velocities(self) -> Array:
        """Velocities at t = 0, where the orbit has none, shape (sites,)."""
        return self.best.kick[self.orbit.model.sites :]

    @property
    def norm(self) -> float:
        """Norm of the kick: Euclidean, or of the energy sqrt(|eta'|^2 + eta L eta) of the gauge."""
        return self.best.norm

    @property
    def escape_time(self) -> float:
        """Time at which the distance is reached."""
        return self.best.time

    @property
    def kkt(self) -> float:
        """Largest residual of the conditions of Karush, Kuhn and Tucker."""
        return self.best.kkt

    @property
    def converged(self) -> bool:
        """Whether the kick is a local optimum, not only one that escapes."""
        return self.best.solved

    @property
    def far_end_kick(self) -> Array:
        """The kick of the paper's Fig. 6(b), a displacement of the far end, at the size that escapes, shape (2N,)."""
        return self.far_end_size * _far_end(self.orbit)

    @cached_property
    def status(self) -> str:
        """The result and how far it can be trusted, in a sentence."""
        o = self.best
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
    *,
    distance: float = 0.5,
    norm: str = "physical",
    at: int | Iterable[int] | None = None,
    starts: int = 8,
    seed: int = 0,
    progress: Report | None = None,
    workers: int = 1,
    executor: Executor | None = None,
) -> SmallestKick:
    """The kick of least norm at phase zero whose distance from the orbit comes to `distance` at a time <= `time`.

    Arguments:
        orbit: a linearly stable breather of a chain.
        time: time allowed.
        distance: relative to ||y(0)||, below the orbit's reach (about 1), where the nearest phase is unique.
        norm: "physical", that of (positions, velocities), or "energy": the root of twice the quadratic part of the
            Hamiltonian of the gauge.
        at: sites that may be kicked, counted from 1; all by default.
        starts: number of starts: first linear optima and the far end, then random directions.
        seed: of these.
        progress: called with a `SearchProgress`, whose objective is the norm, at iterations and ends of starts.
        workers, executor: processes that share the starts.

    Returns:
        The kick with its checks. An interruption ends the search with the best so far.

    Raises:
        ValueError, TypeError: arguments out of range, or an orbit that is not linearly stable.
        KickError: no start escapes.
        KeyboardInterrupt: an interruption before any kick escapes.
    """
    check(orbit, time, distance, norm, starts, seed)
    runner = Runner(progress, workers, executor)
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
    along_far = np.asarray(np.linalg.lstsq(basis, far / np.tile(orbit.model.rho, 2), rcond=None)[0], dtype=float)
    search = KickSearch(flow, distance, basis, scale)
    starting = directions(along_far, gains, vectors, starts, seed)
    outcomes, interrupted = _run(search, starting, runner)
    best, *others = distinct(outcomes)
    checked = verified(search, best)
    try:
        far_size, far_time = size_to_escape(orbit, far, float(time), distance)
    except KeyboardInterrupt:
        far_size, far_time, interrupted = np.nan, np.nan, True
    optima = (checked.optimum, *others)
    return SmallestKick(
        orbit=orbit,
        time=float(time),
        distance=float(distance),
        norm_name=norm,
        optima=tuple(replace(o, kick=search.physical(o.kick), norm=S * o.norm) for o in optima),
        reached=checked.reached,
        linear_norm=S * scale,
        linear_time=float(t[peak]),
        linear_kick=search.physical(scale * vectors[peak, 0]),
        far_end_size=far_size,
        far_end_norm=far_size * kick_norm(orbit, far, norm),
        far_end_time=far_time,
        interrupted=interrupted or checked.interrupted,
        tried=len(outcomes),
    )


def _run(search: KickSearch, starts: list[KickStart], runner: Runner) -> tuple[list[KickOutcome], bool]:
    """Outcomes of the starts, and whether an interruption ended them; raises KickError where no start escapes."""
    with runner.listening():
        outcomes = list(runner.run(search.solve, starts))
    interrupted = runner.interrupted or any(outcome.interrupted for outcome in outcomes)
    if not any(outcome.first is not None for outcome in outcomes):
        if interrupted:
            raise KeyboardInterrupt
        raise KickError(
            f"smallest_kick: none of {len(outcomes)} starts comes to the distance {search.distance:g} "
            f"within t = {search.flow.time:g} at any size tried"
        )
    return outcomes, interrupted


def kick_norm(orbit: Orbit, kick: Array, norm: str = "physical") -> float:
    """Norm of a kick (2N,): Euclidean, or "energy", sqrt(|eta'|^2 + eta L eta) of its image eta in the gauge."""
    if norm == "physical":
        return float(np.linalg.norm(kick))
    e = kick / np.tile(orbit.model.rho, 2)
    n = orbit.model.sites
    return float(np.sqrt(e[:n] @ _stiffness(orbit) @ e[:n] + e[n:] @ e[n:]))


# The norm ------------------------------------------------------------------------------------------------------------


def _far_end(orbit: Orbit) -> Array:
    """A unit displacement of the end opposite to the edge that the modes lean to, shape (2N,)."""
    unit = np.zeros(2 * orbit.model.sites)
    unit[int(np.argmin(orbit.model.log_rho))] = 1.0
    return unit


def _stiffness(orbit: Orbit) -> Array:
    """L of the gauge, shape (sites, sites)."""
    chain: Chain = orbit.model
    off = np.full(chain.sites - 1, -chain.coupling)
    return np.diag(np.full(chain.sites, 2.0 + chain.alpha)) + np.diag(off, 1) + np.diag(off, -1)


def _basis(orbit: Orbit, norm: str, sites: Indices) -> Array:
    """Kicks of the gauge, shape (2N, 2 sites), orthonormal in the norm: a kick is `basis` times unknowns."""
    n = orbit.model.sites
    moved = np.eye(n)[:, sites]
    if norm == "physical":
        positions = velocities = moved / orbit.model.rho[:, None]
    else:
        factor = np.linalg.cholesky(moved.T @ _stiffness(orbit) @ moved)
        positions, velocities = moved @ np.linalg.inv(factor).T, moved
    zero = np.zeros_like(moved)
    return np.block([[positions, zero], [zero, velocities]])
