"""The search for the smallest kick: where it starts, where each start leads, and its check by CVODES."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import newton

from casadi_skin.dynamics.evolution import EvolutionError
from casadi_skin.dynamics.evolve import distance_from_orbit, evolve
from casadi_skin.follow.solution import Orbit
from casadi_skin.lattice.chain import Chain
from casadi_skin.model.arguments import check_name, number, short_repr, whole
from casadi_skin.model.expressions import site_numbers
from casadi_skin.model.result import Result, in_turn, renamed
from casadi_skin.search.cosine_orbit import CosineOrbit
from casadi_skin.search.design import Ending, grouped
from casadi_skin.search.kick_nlp import KickedFlow, KickNlp, KickOptimum, reach
from casadi_skin.search.nlp import Outcome, Start, lost_start, solve_start
from casadi_skin.solve.ipopt import SOLVED_STATUS, Monitor
from casadi_skin.solve.processes import Report, Runner
from casadi_skin.zero.coordinates import numbered
from casadi_skin.zero.problem import Array, Indices

PEAK_WINDOWS = np.array([np.inf] * 4 + [0.03, 0.01, 0.003, 0.001])  # of a period, around a time of escape
PEAK_SAMPLES = 17  # in the finite ones
SIZE_RTOL = 1e-10  # of the size along one direction
SAMPLES_PER_PERIOD = 64  # a period; the largest distance is that of the parabola through the three largest


@dataclass(frozen=True, eq=False)
class Escape:
    """Distance from the orbit against time, each (times,), as `dynamics.distance_from_orbit` defines it."""

    t: Array
    distance: Array

    @property
    def farthest(self) -> tuple[float, float]:
        """The largest distance and its time, by a parabola where it lies between samples."""
        k = int(np.argmax(self.distance))
        if 0 < k < len(self.t) - 1:
            a, b, c = np.polyfit(self.t[k - 1 : k + 2] - self.t[k], self.distance[k - 1 : k + 2], 2)
            if a < 0:
                return float(c - b * b / (4 * a)), float(self.t[k] - b / (2 * a))
        return float(self.distance[k]), float(self.t[k])


@in_turn
def escape(orbit: Orbit | CosineOrbit, kick: ArrayLike, t: ArrayLike, tolerance: float = 1e-11) -> Escape:
    """Distance from the orbit after a kick (2N,) of positions and velocities at t = 0, by CVODES.

    Where the state runs to infinity, as with g < 0, up to the last time before.
    """
    z, sites = np.asarray(kick, dtype=float), orbit.model.sites
    try:
        evolution = evolve(orbit.model, orbit.profile + z[:sites], z[sites:], t, tolerance=tolerance)
    except EvolutionError as error:
        if error.evolution is None:
            raise
        evolution = error.evolution
    return Escape(evolution.t, distance_from_orbit(orbit, evolution))


def sampled(orbit: Orbit, time: float) -> Array:
    """Times from 0 to `time`, SAMPLES or more a period."""
    return np.linspace(0.0, time, 1 + max(8, int(np.ceil(SAMPLES_PER_PERIOD * time / orbit.period))))


@in_turn
def size_to_escape(orbit: Orbit, direction: Array, time: float, distance: float) -> tuple[float, float]:
    """Smallest size of a kick along `direction` (2N,) that escapes, and its time of escape, by CVODES.

    The size that is at the distance at a time, and the time at which that kick is farthest, in turn, first of all times
    and then near by: there an error of the time counts squared. They start from a scan of sizes around that of linear
    growth. Raises ArithmeticError where none escapes.
    """
    flow = KickedFlow.up_to(orbit, time)
    in_gauge = direction / (np.sqrt(orbit.S) * np.tile(orbit.model.rho, 2))
    near = distance / float(flow.linear_gains(in_gauge[:, None])[1].max())
    found = flow.first_to_escape(in_gauge, distance, near)
    if found is None:
        raise ArithmeticError(f"size_to_escape: no size up to {1000 * near:.3g} comes to the distance {distance:g}")
    size, at = found[0], found[1] / flow.steps * time
    for window in orbit.period * PEAK_WINDOWS:

        def excess(size: float, at: float = at) -> float:
            return float(escape(orbit, size * direction, [at]).distance[-1]) - distance

        options: dict[str, Any] = {"rtol": SIZE_RTOL, "tol": SIZE_RTOL * size, "full_output": True, "disp": False}
        size, found = newton(excess, size, **options)
        if not found.converged:
            raise ArithmeticError(f"size_to_escape: no size near {size:.3g} is at the distance {distance:g}")
        near_by = np.linspace(max(0.0, at - window), min(at + window, time), PEAK_SAMPLES)
        around = near_by if np.isfinite(window) else sampled(orbit, time)
        at = escape(orbit, size * direction, around).farthest[1]
    return float(size), float(at)


# The search: where it starts, and where each start leads --------------------------------------------------------------

FLOW_ERROR = 1e-6  # of the distance, against CVODES; the steps are halved until it is met
MOST_REFINEMENTS = 4
SHORTER_KICK_FACTOR = 0.98  # a kick that escapes at this part of its size is searched again from there
LAST_MOMENT = 1e-6  # of the time: an escape in it is at the end of the time allowed


class KickError(ArithmeticError):
    """No kick was found, or none whose flow could be followed; the message says which in one line."""


@dataclass(frozen=True, eq=False)
class KickSearch:
    """A search over kicks `basis` (2N, m) times m unknowns, near the norm `scale`, in units of sqrt(S).

    A start is a direction (m,); Ipopt starts from the size of it that escapes.
    """

    flow: KickedFlow
    distance: float
    basis: Array
    scale: float

    def __reduce__(self) -> tuple[Any, ...]:
        return KickSearch, (self.flow, self.distance, self.basis, self.scale)  # another process builds its own nlp

    @cached_property
    def nlp(self) -> KickNlp:
        """The nonlinear programme, which all starts share."""
        return KickNlp(self.flow, self.distance, self.basis, self.scale)

    def physical(self, kick: Array) -> Array:
        """Positions and velocities (2N,) of unknowns (m,)."""
        orbit = self.flow.orbit
        return np.asarray(np.sqrt(orbit.S) * np.tile(orbit.model.rho, 2) * (self.basis @ kick))

    def first(self, start: Start) -> KickOptimum | None:
        """The smallest multiple of a start's direction that escapes; None where none does."""
        unit = np.array(start.free) / np.linalg.norm(start.free)
        found = self.flow.first_to_escape(self.basis @ unit, self.distance, self.scale)
        if found is None:
            return None
        size, step = found
        return KickOptimum(start.name, size * unit, size, step / self.flow.steps * self.flow.time, np.nan)

    def nlp_at(self, start: Start) -> tuple[KickNlp, Array]:
        """The programme, and the first point of a start; raises ArithmeticError where no size of it escapes."""
        first = self.first(start)
        if first is None:
            raise ArithmeticError("no size escapes")
        return self.nlp, self.nlp.packed(first.kick, first.time)

    def solve(self, start: Start, monitor: Monitor | None = None) -> Outcome:
        """Outcome of a start, from a part of its kick too that escapes at another time; its objective is the norm."""
        found = solve_start(self, start, monitor)
        for _ in range(3):
            if not found.found:
                break
            kick = self.scale * found.place[:-1]
            shorter = self.first(along := replace(start, free=tuple(kick.tolist())))
            if shorter is None or shorter.norm > SHORTER_KICK_FACTOR * np.linalg.norm(kick):
                break
            again = solve_start(self, along, monitor)
            if not again.found or again.objective > found.objective:
                break
            found = replace(again, start=start)
        return found

    def optima(self, outcomes: Sequence[Outcome]) -> list[KickOptimum]:
        """Optima that differ, ascending, each by the name of the first start that led to it.

        Where no start led to one, the first point of least norm, with Ipopt's message in place of an optimum.
        """
        distinct = [one for one, *_ in grouped(sorted(outcomes, key=lambda outcome: outcome.start.number))]
        found = [self.nlp.optimum(one.start.name, one.solution, SOLVED_STATUS) for one in distinct]
        found.sort(key=lambda one: one.norm)
        if found:
            return found
        failures = {o.words for o in outcomes if o.ending not in (Ending.NOT_LOCATED, Ending.INTERRUPTED)}
        firsts = [self.first(o.start) for o in outcomes if o.ending is not Ending.NOT_LOCATED]
        least = min((first for first in firsts if first is not None), key=lambda first: first.norm)
        return [replace(least, words=f"Ipopt: {', '.join(sorted(failures))}" if failures else "Ipopt was not done")]


def verified(search: KickSearch, best: KickOptimum) -> tuple[KickOptimum, float, bool]:
    """The best optimum compared with CVODES, with shorter steps until the two agree.

    Returns it, the distance that CVODES gives it, nan where that is not known, and whether an interruption ended the
    comparison. Raises KickError where the two do not agree.
    """
    reached, distance = np.nan, search.distance
    try:
        for refinement in range(MOST_REFINEMENTS + 1):
            reached = float(escape(search.flow.orbit, search.physical(best.kick), [best.time]).distance[-1])
            if abs(reached - distance) <= FLOW_ERROR * distance or not best.solved:
                return best, reached, False
            if refinement < MOST_REFINEMENTS:
                search = replace(search, flow=replace(search.flow, steps=2 * search.flow.steps))
                solution, reached = search.nlp.solve(search.nlp.packed(best.kick, best.time)), np.nan
                best = search.nlp.optimum(best.name, solution)
    except KeyboardInterrupt:
        return best, reached, True
    raise KickError(
        f"smallest_kick: CVODES gives {reached:.6g} in place of {distance:g} at t = {best.time:.6g} with "
        f"{search.flow.steps} steps; a shorter time or an orbit of a tighter tolerance may help"
    )


def directions(far: Array, gains: Array, vectors: Array, starts: int, seed: int) -> list[Start]:
    """Directions (m,): linear optima at the highest peaks of the gains, the far end, random ones."""
    first = gains[:, 0]
    padded = np.concatenate([[-np.inf], first, [-np.inf]])
    peaks = np.flatnonzero((first >= padded[:-2]) & (first >= padded[2:]))
    peaks = peaks[np.argsort(-first[peaks], kind="stable")]
    named = [("linear optimum", vectors[peaks[0], 0])]
    if np.any(far):
        named.append(("far end", far))
    if len(peaks) > 1:
        named.append(("linear optimum of another time", vectors[peaks[1], 0]))
    if vectors.shape[1] > 1:
        named.append(("second singular vector", vectors[peaks[0], 1]))
    signed = [(f"{sign}{name}", factor * v) for name, v in named for sign, factor in (("", 1.0), ("minus ", -1.0))]
    generator, size = np.random.default_rng(seed), vectors.shape[2]
    chosen = signed[: starts - starts // 4]
    chosen += [(f"random {k + 1}", generator.normal(size=size)) for k in range(starts - len(chosen))]
    return [Start(number, tuple(v.tolist()), name) for number, (name, v) in enumerate(chosen, start=1)]


# Arguments of the search for the smallest kick, checked ---------------------------------------------------------------

KICK_NORMS = ("physical", "energy")
LEAST_DISTANCE = 1e-4
LONGEST_PERIODS = 100.0  # periods


def check(orbit: Orbit, time: float, distance: float, norm: str, starts: int, seed: int) -> None:
    """Raises TypeError or ValueError for arguments out of range or an orbit that is not linearly stable."""
    if not isinstance(orbit, Orbit) or not isinstance(orbit.model, Chain):
        raise TypeError(f"orbit: given {short_repr(orbit)}; accepted: an Orbit of a chain, such as branch.at(S=0.2)")
    chain = orbit.model
    if chain.infinite or abs(chain.gamma) == 1.0:
        raise ValueError(f"orbit: given sites = {chain.sites}, gamma = {chain.gamma!r}; accepted: finite, |gamma| < 1")
    if orbit.S <= 0:
        raise ValueError("orbit: given S = 0; accepted: a breather of S > 0")
    if not 0 < number("time", time, "a finite time > 0") <= LONGEST_PERIODS * orbit.period:
        raise ValueError(
            f"time: given {time!r}; "
            f"accepted: above 0, up to {LONGEST_PERIODS:g} periods = {LONGEST_PERIODS * orbit.period:.6g}"
        )
    least = max(LEAST_DISTANCE, 1e3 * orbit.profile_error)
    if number("distance", distance, "a finite fraction of the breather") < least:
        raise ValueError(f"distance: given {distance!r}; accepted: from {least:.1e} on, what the orbit's error allows")
    check_name("norm", norm, KICK_NORMS)
    if norm == "energy" and not chain.alpha + 2.0 > 2.0 * chain.coupling * np.cos(np.pi / (chain.sites + 1)):
        raise ValueError("norm: given 'energy', which is not positive in this chain; accepted: physical")
    whole("starts", starts, 1)
    whole("seed", seed, 0)
    if not orbit.floquet().stable:
        largest = orbit.floquet().max_abs_multiplier
        raise ValueError(
            f"orbit: the breather is linearly unstable (largest multiplier {largest:.6g}); accepted: a stable one"
        )


# The smallest kick that takes a linearly stable breather away within a given time -------------------------------------

REACH_SHARE = 0.99  # of the orbit's reach, which is known on a grid of phases
GAIN_STEPS = 8  # for each of the flow's: the gain swings twice a period, and its peak is missed by up to 0.01 %


@dataclass(frozen=True, eq=False)
class SmallestKick(Result):
    """The smallest kick of a search; dimensionless. Comparisons that are missing, as after an interruption, are nan.

    Attributes:
        orbit, time, distance, norm_name: the arguments.
        optima: all local optima, ascending; the first is this one.
        reached: the distance that CVODES gives at `escape_time`.
        linear_norm, linear_time, linear_kick: the kick that linear transient growth predicts.
        far_end_size: displacement of the far end alone that escapes within the same time; `far_end_norm` is its norm,
            `far_end_time` the time of its escape.
        interrupted: whether an interruption ended the search.
        tried: number of starts that have ended.
        lost: starts whose worker was ended twice, in words; empty where there is none.
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
    lost: str = ""

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
        end = "the kick itself is that far" if self.escape_time < LAST_MOMENT * self.time else "inside the time allowed"
        if self.escape_time > (1.0 - LAST_MOMENT) * self.time:
            end = "at the end of the time allowed"
        words += f"; distance {self.reached:.6g}" if np.isfinite(self.reached) else "; not yet compared with CVODES"
        words += f" at t = {self.escape_time:.6g}, {end}"
        words += f"; {self.lost}" if self.lost else ""
        return f"interrupted: {words}" if self.interrupted else words

    def evolution(self, kick: Array | None = None) -> Escape:
        """Distance against time up to the time allowed by CVODES, of this kick or another (2N,)."""
        return escape(self.orbit, self.best.kick if kick is None else kick, sampled(self.orbit, self.time))


@renamed(at="sites")
@in_turn
def smallest_kick(
    orbit: Orbit,
    time: float,
    *,
    distance: float = 0.5,
    norm: str = "physical",
    sites: ArrayLike | None = None,
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
        sites: those that may be kicked, counted from 1; all by default.
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
    runner = Runner(progress, workers, executor, lost_start)
    kicked = np.unique(numbered(site_numbers(sites), orbit.model.sites))
    if not kicked.size:
        raise ValueError("sites: given none; accepted: one or more")
    flow = KickedFlow.up_to(orbit, float(time))
    farthest_known = REACH_SHARE * reach(flow.curve)
    if not distance < farthest_known:
        words = f"below {farthest_known:.4g}, within which the nearest phase of this orbit is unique"
        raise ValueError(f"distance: given {distance!r}; accepted: {words}")
    basis, S = _basis(orbit, norm, kicked), float(np.sqrt(orbit.S))
    t, gains, vectors = replace(flow, steps=GAIN_STEPS * flow.steps).linear_gains(basis)
    peak = int(np.argmax(gains[:, 0]))
    scale = float(distance / gains[peak, 0])
    far = _far_end(orbit)
    along_far = np.asarray(np.linalg.lstsq(basis, far / np.tile(orbit.model.rho, 2), rcond=None)[0], dtype=float)
    search = KickSearch(flow, distance, basis, scale)
    starting = directions(along_far, gains, vectors, starts, seed)
    with runner.listening():
        outcomes: list[Outcome] = list(runner.run(search.solve, starting))
    lost = [o for o in outcomes if o.ending is Ending.INTERRUPTED and not runner.interrupted]
    outcomes, interrupted = [o for o in outcomes if o not in lost], runner.interrupted
    if all(outcome.ending is Ending.NOT_LOCATED for outcome in outcomes):
        if interrupted:
            raise KeyboardInterrupt
        if lost:
            raise KickError(f"smallest_kick: start {lost[0].start.number}: {lost[0].words}, twice")
        words = f"none of {len(outcomes)} starts comes to the distance {distance:g}"
        raise KickError(f"smallest_kick: {words} within t = {flow.time:g} at any size tried")
    best, *others = search.optima(outcomes)
    best, reached, stopped = verified(search, best)
    try:
        far_size, far_time = size_to_escape(orbit, far, float(time), distance)
    except (KeyboardInterrupt, ArithmeticError) as error:
        far_size, far_time, interrupted = np.nan, np.nan, interrupted or isinstance(error, KeyboardInterrupt)
    return SmallestKick(
        orbit=orbit,
        time=float(time),
        distance=float(distance),
        norm_name=norm,
        optima=tuple(replace(o, kick=search.physical(o.kick), norm=S * o.norm) for o in (best, *others)),
        reached=reached,
        linear_norm=S * scale,
        linear_time=float(t[peak]),
        linear_kick=search.physical(scale * vectors[peak, 0]),
        far_end_size=far_size,
        far_end_norm=far_size * kick_norm(orbit, far, norm),
        far_end_time=far_time,
        interrupted=interrupted or stopped,
        tried=len(outcomes),
        lost="; ".join(f"start {outcome.start.number}: {outcome.words}, twice" for outcome in lost),
    )


@in_turn
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
