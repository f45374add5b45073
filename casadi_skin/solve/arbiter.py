"""Newton's method first, at a fraction of Ipopt's cost; Ipopt where it fails, which also confirms the results.

A call of Ipopt that has nothing to do costs more than a Newton step. Several orbits are confirmed in one call: the
nonlinear programme of independent blocks, one an orbit, takes half of what the calls take one by one.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

import numpy as np

from casadi_skin.solve.ipopt import STATUS_BY_WORDS, IpoptCorrector, SquareSolver, residual_scale
from casadi_skin.solve.newton import Correction, HeldState, NewtonCorrector, Status
from casadi_skin.solve.watch import heed
from casadi_skin.zero.collocation import CollocationEquations
from casadi_skin.zero.problem import Array, Problem

NEWTON_STEPS = 10  # of Newton's method, before Ipopt is called
STEP_SHRINKAGE = (
    0.5  # of each step to the next at least: the solution is within two steps of the guess then (Kantorovich)
)
AGREED_TOLERANCES = 10.0  # tolerances within which Ipopt's solution is the same as that of Newton's method
MOST_IPOPT_ITERATIONS = 20


class ConfirmedCorrector:
    """Newton's method, and Ipopt from the same guess where its steps do not shrink fast: they may lead anywhere then.

    `together` is the number of points that one call of Ipopt confirms.
    """

    def __init__(self, problem: Problem, tolerance: float = 1e-12, together: int = 1) -> None:
        self.problem, self.tolerance, self.together = problem, tolerance, together
        self._newton = NewtonCorrector(problem, tolerance, NEWTON_STEPS, STEP_SHRINKAGE)
        self._one: list[IpoptCorrector] = []  # none before it is needed; the list is that of all copies

    def on(self, problem: Problem) -> ConfirmedCorrector:
        """This corrector for a problem that differs in its constants only; nothing is built again."""
        if problem is self.problem:
            return self
        other = copy.copy(self)
        other.problem, other._newton = problem, self._newton.on(problem)
        return other

    def _ipopt(self) -> IpoptCorrector:
        """Ipopt on one orbit, built when it is first needed."""
        if not self._one:
            self._one.append(IpoptCorrector(self.problem, self.tolerance, MOST_IPOPT_ITERATIONS))
        return self._one[0].on(self.problem)

    def _several(self) -> SquareSolver:
        """Ipopt on several orbits, built when it is first needed."""
        shared, key = self.problem.shared, ("several", self.tolerance, self.together)
        if key not in shared:
            shared[key] = SquareSolver(self.problem, self.together, self.tolerance, MOST_IPOPT_ITERATIONS)
        found: SquareSolver = shared[key]
        return found

    def _solved(self, points: Sequence[HeldState]) -> tuple[Array, str, int]:
        """Ipopt's solutions for up to `together` points, its words and iterations; the last point fills the rest."""
        solver, size = self._several(), self.problem.size
        solver.numbers[:] = self.problem.numbers
        for k in range(self.together):
            z, row, value = points[min(k, len(points) - 1)]
            solver.guess[k], solver.held[k, :size], solver.held[k, size] = z, row, value
            solver.held[k, size + 1] = residual_scale(self.problem, z)
        found, words, iterations = solver.solve()
        return found[: len(points)], words, iterations

    def correct(self, guess: Array, row: Array, value: float) -> Correction:
        """Corrected point with row . z = value, or a named failure."""
        correction = self._newton.correct(guess, row, value)
        return correction if correction.converged else self._ipopt().correct(guess, row, value)

    def confirm_all(self, points: Sequence[HeldState]) -> list[Correction]:
        """The verdicts of Ipopt on solutions: each itself where it agrees; one by one where it does not solve all."""
        if self.together == 1:
            return self._agreed([z for z, _, _ in points], [self._ipopt().correct(*point) for point in points])
        results: list[Correction] = []
        for first in range(0, len(points), self.together):
            some = points[first : first + self.together]
            heed(f"Ipopt, {self.problem.size * self.together} unknowns")
            found, words, iterations = self._solved(some)
            if STATUS_BY_WORDS.get(words) is Status.CONVERGED and np.all(np.isfinite(found)):
                corrections = [Correction(z, Status.CONVERGED, iterations, words) for z in found]
            else:
                corrections = [self._ipopt().correct(*point) for point in some]
            results += self._agreed([z for z, _, _ in some], corrections)
        return results

    def _agreed(self, states: Sequence[Array], corrections: Sequence[Correction]) -> list[Correction]:
        """The corrections of states, by these themselves where they are the same within the tolerance."""
        z = np.stack(states)
        steps = np.stack([correction.z for correction in corrections]) - z
        with np.errstate(all="ignore"):
            apart = np.sqrt(np.sum(self.problem.metrics(z, 1.0) * steps**2, axis=1))
        same = (apart <= AGREED_TOLERANCES * self.tolerance).tolist()
        return [
            Correction(state, found.status, found.iterations) if agrees and found.converged else found
            for state, found, agrees in zip(states, corrections, same, strict=True)
        ]


# Newton's method first, at a fraction of Ipopt's cost; Ipopt where it fails, and as arbiter of reported results -------

LOWER_STEPS = 30  # of that with smaller residuals at each


class ArbitratedCorrector:
    """Newton's method on collocation equations, and Ipopt from the same guess where that does not converge at once.

    Steps that do not shrink fast leave the neighbourhood of the guess, perhaps for a solution of another family. They
    are taken where Ipopt takes them too, as long as the residuals decrease, with factors that cost less than its own in
    long systems; and where Ipopt finds none, as in stiff problems far from their guess.

    With `always` Ipopt is called for every verdict, else where a solution does not meet its test as it is.
    """

    def __init__(
        self,
        problem: CollocationEquations,
        tolerance: float = 1e-12,
        max_iterations: int = 20,
        always: bool = True,
    ) -> None:
        self.problem, self.tolerance, self.max_iterations, self._always = problem, tolerance, max_iterations, always
        self._newton = NewtonCorrector(problem, tolerance, NEWTON_STEPS, STEP_SHRINKAGE)

    def on(self, problem: Any) -> ArbitratedCorrector:
        """This corrector for a problem that differs in its constants only; nothing is built again."""
        other = copy.copy(self)
        other.problem, other._newton = problem, self._newton.on(problem)
        return other

    def _ipopt(self, one_scalar: bool) -> IpoptCorrector:
        """Ipopt on equations of this number of intervals, built when it is first needed."""
        shared = self.problem.shared
        key = ("ipopt", one_scalar, self.tolerance, self.max_iterations)
        if key not in shared:
            shared[key] = IpoptCorrector(self.problem, self.tolerance, self.max_iterations, one_scalar)
        found: IpoptCorrector = shared[key]
        return found.on(self.problem)

    def correct(self, guess: Array, row: Array, value: float) -> Correction:
        """Corrected point with row . z = value, or a named failure."""
        correction = self._newton.correct(guess, row, value)
        if not correction.converged:
            decreasing = NewtonCorrector(self.problem, self.tolerance, LOWER_STEPS, decreasing=True)
            correction = decreasing.correct(guess, row, value)
        if correction.converged:
            return correction
        correction = self._ipopt(not np.any(row[: self.problem.states])).correct(guess, row, value)
        if correction.converged:
            return correction
        last = NewtonCorrector(self.problem, self.tolerance, NEWTON_STEPS).correct(guess, row, value)
        return last if last.converged else correction

    def confirm(self, z: Array, row: Array, value: float) -> Correction:
        """The verdict of Ipopt on a solution: z itself where it agrees, whatever its earlier calls.

        The free parameter is held in place of `row` where that will do: a row through all unknowns costs more.
        """
        if not self._always and self._is_optimal(z):
            return Correction(z, Status.CONVERGED, 0)
        held = self.problem.parameter_row()
        found = self._ipopt(True).correct(z, held, float(held @ z))
        if not found.converged and np.any(row[: self.problem.states]):
            found = self._ipopt(False).correct(z, row, value)
        if not found.converged:
            return found
        step = found.z - z
        apart = float(np.sqrt(np.sum(self.problem.metric(z, 1.0) * step**2)))
        return Correction(z, found.status, 0) if apart <= AGREED_TOLERANCES * self.tolerance else found

    def _is_optimal(self, z: Array) -> bool:
        """Whether z meets the test at which Ipopt ends: no scaled residual above the tolerance."""
        scaled = np.max(np.abs(self.problem.evaluate(z)[0])) / residual_scale(self.problem, z)
        return bool(scaled <= self.tolerance)
