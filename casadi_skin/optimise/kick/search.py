"""The search for the smallest kick: where it starts, what it keeps, and its check by CVODES."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np

from casadi_skin.optimise.kick.flow import KickedFlow
from casadi_skin.optimise.kick.nlp import KickProgramme, Optimum
from casadi_skin.optimise.kick.verify import escape
from casadi_skin.theory.linear import Array

FLOW_ERROR = 1e-6  # of the distance, against CVODES; the steps are halved until it is met
REFINEMENTS = 4
SAME = 1e-3  # relative difference of kicks that count as one optimum
SHORTER = 0.98  # a kick that escapes at this part of its size is searched again from there


class StopRequestError(Exception):
    """What hears of an iteration raises it to end a start there; it is answered with what the start had."""


class KickError(ArithmeticError):
    """No kick was found, or none whose flow could be followed: the message tells in one line."""


@dataclass(frozen=True)
class KickProgress:
    """Where a search is: start by number and name, iteration of Ipopt, norm of the kick, largest violation.

    `done` of `starts` have ended. Other processes tell of the end of a start as well, with an infinite norm where no
    size of it escapes.
    """

    start: int
    starts: int
    name: str
    iteration: int
    norm: float
    violation: float
    done: int

    def __str__(self) -> str:
        return (
            f"{self.done} of {self.starts} starts done; start {self.start} ({self.name}), iteration {self.iteration}: "
            f"norm {self.norm:.6g}, violation {self.violation:.1e}"
        )


@dataclass(frozen=True, eq=False)
class Ended:
    """What one of the directions led to: a start where one of its sizes escapes, and where Ipopt ended from there."""

    number: int
    name: str
    start: Optimum | None = None
    found: Optimum | None = None
    interrupted: bool = False


class KickSearch:
    """Solves the programme from many directions and keeps what it found."""

    def __init__(
        self,
        flow: KickedFlow,
        distance: float,
        basis: Array,
        scale: float,
        starts: int,
        progress: Callable[[KickProgress], None] | None,
    ) -> None:
        self.flow, self.distance, self.basis, self.scale, self.starts = flow, distance, basis, scale, starts
        self.progress, self.number, self.name = progress, 0, ""
        self._numbers: dict[str, int] = {}
        self.tried, self.done, self.interrupted = 0, 0, False
        self._built: KickProgramme | None = None

    @property
    def programme(self) -> KickProgramme:
        """The programme of the flow as it is now."""
        if self._built is None or self._built.flow is not self.flow:
            self._built = KickProgramme(self.flow, self.distance, self.basis, self.scale, self._say)
        return self._built

    def _say(self, iteration: int, objective: float, violation: float) -> None:
        if self.progress is not None:
            norm = float(np.sqrt(self.flow.orbit.S * objective)) * self.scale
            self.progress(KickProgress(self.number, self.starts, self.name, iteration, norm, violation, self.done))

    def from_all(
        self, named: Sequence[tuple[str, Array]], elsewhere: Generator[Ended] | None = None
    ) -> tuple[list[tuple[str, Optimum]], bool]:
        """Distinct optima, ascending, and whether the search was interrupted; the smallest start where none is found.

        `elsewhere` gives what the directions led to, as they end, where other processes follow them. Raises KickError
        where no direction escapes, KeyboardInterrupt after an interruption before one was found that does.
        """
        ended: list[Ended] = []
        self._numbers = {name: number for number, (name, _) in enumerate(named, start=1)}
        with closing(self._one_by_one(named) if elsewhere is None else elsewhere) as following:
            try:
                for one in following:
                    ended.append(one)
                    self.done = len(ended)
                    self.interrupted |= one.interrupted
            except KeyboardInterrupt:
                self.interrupted = True
        ended.sort(key=lambda one: one.number)
        starts = [(one.name, one.start) for one in ended if one.start is not None]
        if not starts and self.interrupted:
            raise KeyboardInterrupt
        if not starts:
            raise KickError(
                f"smallest_kick: none of {self.tried} starts comes to the distance {self.distance:g} "
                f"within t = {self.flow.time:g} at any size tried"
            )
        return _distinct(ended) or [_smallest(starts, ended)], self.interrupted

    def _one_by_one(self, named: Sequence[tuple[str, Array]]) -> Generator[Ended]:
        for number, (name, direction) in enumerate(named, start=1):
            self.tried += 1
            yield (ended := self.follow(number, name, direction))
            if ended.interrupted:
                return

    def follow(self, number: int, name: str, direction: Array) -> Ended:
        """What a direction (m,) leads to; raises KeyboardInterrupt only before a size of it is known to escape."""
        self.number, self.name = number, name
        start = self._start(direction)
        if start is None:
            return Ended(number, name)
        try:
            return Ended(number, name, start, self._solved(start))
        except (KeyboardInterrupt, StopRequestError):
            return Ended(number, name, start, interrupted=True)

    def _start(self, direction: Array) -> Optimum | None:
        """The smallest multiple of a direction (m,) that escapes, as a start of the programme."""
        unit = direction / np.linalg.norm(direction)
        found = self.flow.first_to_escape(self.basis @ unit, self.distance, self.scale)
        if found is None:
            return None
        size, step, _ = found
        share = step / self.flow.steps
        shorter = replace(self.flow, time=share * self.flow.time)
        phase = self.flow.nearest_phase(shorter.run((size * self.basis @ unit)[None])[0, -1])
        return Optimum(size * unit, size, shorter.time, phase, np.inf, np.inf, False, 0, "not solved")

    def _solved(self, start: Optimum) -> Optimum:
        """The optimum from a start, and from shorter ones where a part of it escapes at another time."""
        found = self._solve(start)
        for _ in range(3):
            shorter = self._start(found.kick) if found.solved else None
            if shorter is None or shorter.norm > SHORTER * found.norm:
                break
            again = self._solve(shorter)
            if not again.solved or again.norm > found.norm:
                break
            found = again
        return found

    def _solve(self, start: Optimum) -> Optimum:
        states = replace(self.flow, time=start.time).run((self.basis @ start.kick)[None])[0]
        return self.programme.solve(start.kick, start.time / self.flow.time, start.phase, states)

    def verified(
        self, optima: list[tuple[str, Optimum]]
    ) -> tuple[tuple[str, Optimum], float, list[tuple[str, Optimum]]]:
        """The best, the distance that CVODES gives it, and the others; with shorter steps until the two agree.

        After an interruption the best as it is, with nan for a distance that is not known. Raises KickError where the
        two do not agree.
        """
        (name, best), others, orbit = optima[0], optima[1:], self.flow.orbit
        reached = np.nan
        try:
            for refinement in range(REFINEMENTS + 1):
                kick = np.sqrt(orbit.S) * np.tile(orbit.chain.rho, 2) * (self.basis @ best.kick)
                reached = float(escape(orbit, kick, [best.time]).distance[-1])
                if abs(reached - self.distance) <= FLOW_ERROR * self.distance or not best.solved:
                    return (name, best), reached, others
                if refinement < REFINEMENTS:
                    self.flow = replace(self.flow, steps=2 * self.flow.steps)
                    self.number, self.name = self._numbers[name], name
                    best, reached = self._solve(best), np.nan
        except KeyboardInterrupt:
            self.interrupted = True
            return (name, best), reached, others
        raise KickError(
            f"smallest_kick: CVODES gives {reached:.6g} in place of {self.distance:g} at t = {best.time:.6g} with "
            f"{self.flow.steps} steps; a shorter time or an orbit of a tighter tolerance may help"
        )


def _same(a: Optimum, b: Optimum) -> bool:
    return float(np.linalg.norm(a.kick - b.kick)) <= SAME * max(a.norm, b.norm) and abs(a.time / b.time - 1) <= SAME


def _distinct(ended: Sequence[Ended]) -> list[tuple[str, Optimum]]:
    """Optima that differ, each by the name of the first that led to it, ascending."""
    optima: list[tuple[str, Optimum]] = []
    for name, found in ((one.name, one.found) for one in ended):
        if found is not None and found.solved and not any(_same(found, other) for _, other in optima):
            optima.append((name, found))
    return sorted(optima, key=lambda item: item[1].norm)


def _smallest(starts: Sequence[tuple[str, Optimum]], ended: Sequence[Ended]) -> tuple[str, Optimum]:
    """The start of least norm, with what Ipopt said in place of an optimum."""
    failures = {one.found.words for one in ended if one.found is not None and not one.found.solved}
    words = f"Ipopt: {', '.join(sorted(failures))}" if failures else "Ipopt was not done"
    name, start = min(starts, key=lambda item: item[1].norm)
    return name, replace(start, words=words)


def directions(far: Array, gains: Array, vectors: Array, starts: int, seed: int) -> list[tuple[str, Array]]:
    """Named directions (m,): linear optima at the highest peaks of the gains, the far end, random ones."""
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
    generator = np.random.default_rng(seed)
    chosen = signed[: starts - starts // 4]
    size = vectors.shape[2]
    return chosen + [(f"random {k + 1}", generator.normal(size=size)) for k in range(starts - len(chosen))]
