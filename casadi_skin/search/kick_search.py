"""The search for the smallest kick: where it starts, what it keeps, and its check by CVODES."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casadi_skin.search.kick_check import escape
from casadi_skin.search.kick_flow import KickedFlow
from casadi_skin.search.kick_programme import KickProgramme, Optimum
from casadi_skin.theory.linear import Array

FLOW_ERROR = 1e-6  # of the distance, against CVODES; the steps are halved until it is met
REFINEMENTS = 4
SAME = 1e-3  # relative difference of kicks that count as one optimum
SHORTER = 0.98  # a kick that escapes at this part of its size is searched again from there


class KickError(ArithmeticError):
    """No kick was found, or none whose flow could be followed: the message tells in one line."""


@dataclass(frozen=True)
class KickProgress:
    """Where a search is: start by number and name, iteration of Ipopt, norm of the kick, largest violation."""

    start: int
    starts: int
    name: str
    iteration: int
    norm: float
    violation: float


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
        self.progress, self.tried, self.name = progress, 0, ""
        self.programme = self._programme()

    def _programme(self) -> KickProgramme:
        return KickProgramme(self.flow, self.distance, self.basis, self.scale, self._say)

    def _say(self, iteration: int, objective: float, violation: float) -> None:
        if self.progress is not None:
            norm = float(np.sqrt(self.flow.orbit.S * objective)) * self.scale
            self.progress(KickProgress(self.tried, self.starts, self.name, iteration, norm, violation))

    def from_all(self, named: Sequence[tuple[str, Array]]) -> tuple[list[tuple[str, Optimum]], bool]:
        """Distinct optima, ascending, and whether the search was interrupted; the smallest start where none is found.

        Raises KickError where no direction escapes.
        """
        optima: list[tuple[str, Optimum]] = []
        smallest: tuple[str, Optimum] | None = None
        interrupted, failures = False, set[str]()
        try:
            for self.name, direction in named:
                self.tried += 1
                start = self._start(direction)
                if start is None:
                    continue
                if smallest is None or start.norm < smallest[1].norm:
                    smallest = self.name, start
                found = self._solved(start)
                failures |= set() if found.solved else {found.words}
                if found.solved and not any(_same(found, other) for _, other in optima):
                    optima.append((self.name, found))
        except KeyboardInterrupt:
            if smallest is None:
                raise
            interrupted = True
        if smallest is None:
            raise KickError(
                f"smallest_kick: none of {self.tried} starts comes to the distance {self.distance:g} "
                f"within t = {self.flow.time:g} at any size tried"
            )
        if not optima:
            words = f"Ipopt: {', '.join(sorted(failures))}" if failures else "Ipopt was not done"
            optima = [(smallest[0], replace(smallest[1], words=words))]
        return sorted(optima, key=lambda item: item[1].norm), interrupted

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

        Raises KickError where they do not.
        """
        (name, best), others = optima[0], optima[1:]
        for refinement in range(REFINEMENTS + 1):
            orbit = self.flow.orbit
            kick = np.sqrt(orbit.S) * np.tile(orbit.chain.rho, 2) * (self.basis @ best.kick)
            reached = float(escape(orbit, kick, [best.time]).distance[-1])
            if abs(reached - self.distance) <= FLOW_ERROR * self.distance or not best.solved:
                return (name, best), reached, others
            if refinement < REFINEMENTS:
                self.flow = replace(self.flow, steps=2 * self.flow.steps)
                self.programme, self.name = self._programme(), name
                best = self._solve(best)
        raise KickError(
            f"smallest_kick: CVODES gives {reached:.6g} in place of {self.distance:g} at t = {best.time:.6g} with "
            f"{self.flow.steps} steps; a shorter time or an orbit of a tighter tolerance may help"
        )


def _same(a: Optimum, b: Optimum) -> bool:
    return float(np.linalg.norm(a.kick - b.kick)) <= SAME * max(a.norm, b.norm) and abs(a.time / b.time - 1) <= SAME


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
