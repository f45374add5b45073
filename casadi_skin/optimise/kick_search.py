"""The search for the smallest kick: where it starts, where each start leads, and its check by CVODES."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from casadi_skin.optimise.kick_flow import KickedFlow
from casadi_skin.optimise.kick_nlp import KickNlp, KickOptimum
from casadi_skin.optimise.kick_verify import escape
from casadi_skin.optimise.nlp import STOPPED
from casadi_skin.solve.iteration_callback import Monitor
from casadi_skin.solve.nlp import nlp_reason
from casadi_skin.zero.problem import Array

FLOW_ERROR = 1e-6  # of the distance, against CVODES; the steps are halved until it is met
REFINEMENTS = 4
SAME = 1e-3  # relative difference of kicks that count as one optimum
SHORTER = 0.98  # a kick that escapes at this part of its size is searched again from there


class KickError(ArithmeticError):
    """No kick was found, or none whose flow could be followed; the message says which in one line."""


@dataclass(frozen=True, eq=False)
class KickStart:
    """A direction (m,) that a search starts from, by number and name."""

    number: int
    name: str
    direction: Array


@dataclass(frozen=True, eq=False)
class KickOutcome:
    """Where a start leads: `first`, the size of it that escapes, if any, and `found`, where Ipopt ended from there.

    `last` has iterations, norm and violation.
    """

    start: KickStart
    first: KickOptimum | None = None
    found: KickOptimum | None = None
    last: tuple[int, float, float] = (0, np.inf, np.inf)

    @property
    def interrupted(self) -> bool:
        """Whether an interruption ended it."""
        return self.found is not None and self.found.words == STOPPED


@dataclass(frozen=True, eq=False)
class KickSearch:
    """A search over kicks `basis` (2N, m) times m unknowns, near the norm `scale`, in units of sqrt(S)."""

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

    def solve(self, start: KickStart, monitor: Monitor | None = None) -> KickOutcome:
        """Outcome of a start; raises KeyboardInterrupt only before a size of it escapes."""
        first = self._first(start.name, start.direction)
        if first is None:
            return KickOutcome(start)
        try:
            found = self._from(first, monitor)
        except KeyboardInterrupt:
            found = replace(first, words=STOPPED)
        last = (found.iterations, float(np.sqrt(self.flow.orbit.S)) * found.norm, found.violation)
        return KickOutcome(start, first, found, last)

    def _first(self, name: str, direction: Array) -> KickOptimum | None:
        """The smallest multiple of a direction (m,) that escapes, as a point that Ipopt starts from."""
        unit = direction / np.linalg.norm(direction)
        found = self.flow.first_to_escape(self.basis @ unit, self.distance, self.scale)
        if found is None:
            return None
        size, step = found
        shorter = replace(self.flow, time=step / self.flow.steps * self.flow.time)
        phase = self.flow.nearest_phase(shorter.run((size * self.basis @ unit)[None])[0, -1])
        return KickOptimum(name, size * unit, size, shorter.time, phase)

    def _from(self, first: KickOptimum, monitor: Monitor | None) -> KickOptimum:
        """The optimum from a point, and from shorter ones where a part of it escapes at another time."""
        found = self.optimum(first, monitor)
        for _ in range(3):
            shorter = self._first(first.name, found.kick) if found.solved else None
            if shorter is None or shorter.norm > SHORTER * found.norm:
                break
            again = self.optimum(shorter, monitor)
            if not again.solved or again.norm > found.norm:
                break
            found = again
        return found

    def optimum(self, first: KickOptimum, monitor: Monitor | None = None) -> KickOptimum:
        """End of Ipopt from a point."""
        states = replace(self.flow, time=first.time).run((self.basis @ first.kick)[None])[0]
        size = np.sqrt(self.flow.orbit.S) * self.scale  # the objective is the squared norm in these units
        report = monitor and (lambda i, f, v: monitor(i, float(size * np.sqrt(f)), v))
        return self.nlp.optimum(first, states, report)


def distinct(outcomes: Sequence[KickOutcome]) -> list[KickOptimum]:
    """Optima that differ, each by the name of the first start that led to it, ascending.

    Where no start led to one, the first point of least norm, with Ipopt's message in place of an optimum.
    """
    optima: list[KickOptimum] = []
    for found in (o.found for o in sorted(outcomes, key=lambda o: o.start.number)):
        if found is not None and found.solved and not any(_same(found, other) for other in optima):
            optima.append(found)
    if optima:
        return sorted(optima, key=lambda optimum: optimum.norm)
    failures = {o.found.words for o in outcomes if o.found is not None and not o.interrupted}
    words = f"Ipopt: {', '.join(sorted(map(nlp_reason, failures)))}" if failures else "Ipopt was not done"
    least = min((o.first for o in outcomes if o.first is not None), key=lambda first: first.norm)
    return [replace(least, words=words)]


def _same(a: KickOptimum, b: KickOptimum) -> bool:
    return float(np.linalg.norm(a.kick - b.kick)) <= SAME * max(a.norm, b.norm) and abs(a.time / b.time - 1) <= SAME


@dataclass(frozen=True, eq=False)
class Verified:
    """An optimum, the distance that CVODES gives it (nan where that is not known), and the search that agrees."""

    optimum: KickOptimum
    reached: float
    search: KickSearch
    interrupted: bool = False


def verified(search: KickSearch, best: KickOptimum) -> Verified:
    """The best optimum compared with CVODES, with shorter steps until the two agree.

    After an interruption the best as it is. Raises KickError where the two do not agree.
    """
    reached, distance = np.nan, search.distance
    try:
        for refinement in range(REFINEMENTS + 1):
            reached = float(escape(search.flow.orbit, search.physical(best.kick), [best.time]).distance[-1])
            if abs(reached - distance) <= FLOW_ERROR * distance or not best.solved:
                return Verified(best, reached, search)
            if refinement < REFINEMENTS:
                search = replace(search, flow=replace(search.flow, steps=2 * search.flow.steps))
                best, reached = search.optimum(best), np.nan
    except KeyboardInterrupt:
        return Verified(best, reached, search, interrupted=True)
    raise KickError(
        f"smallest_kick: CVODES gives {reached:.6g} in place of {distance:g} at t = {best.time:.6g} with "
        f"{search.flow.steps} steps; a shorter time or an orbit of a tighter tolerance may help"
    )


def directions(far: Array, gains: Array, vectors: Array, starts: int, seed: int) -> list[KickStart]:
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
    return [KickStart(number, name, v) for number, (name, v) in enumerate(chosen, start=1)]
