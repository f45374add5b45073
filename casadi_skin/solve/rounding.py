"""A corrector that takes residuals of the size of their rounding for converged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from casadi_skin.solve.corrector import Correction, Corrector, Status
from casadi_skin.zero.problem import Array, Problem

TO_ROUNDING = "to rounding"
ROUNDED = 4.0  # times the rounding of the largest term


class RoundedCorrector:
    """Another corrector, whose tolerance may lie below the rounding errors of residuals with large terms.

    Where it stops at residuals that are rounding alone the equations are solved: the estimated error of the point
    includes rounding and shows its accuracy.
    """

    def __init__(self, inner: Corrector) -> None:
        self.inner, self.problem = inner, inner.problem

    def on(self, problem: Problem) -> RoundedCorrector:
        """This corrector for a problem that differs in its constants only; nothing is built again."""
        return RoundedCorrector(self.inner.on(problem))

    def correct(self, guess: Array, row: Array, value: float) -> Correction:
        """Corrected point near `guess`, or a named failure; `row` has shape (size,)."""
        return self._rounded(self.inner.correct(guess, row, value), row, value)

    def confirm(self, z: Array, row: Array, value: float) -> Correction:
        """A solution as the last word has it: z itself where the inner corrector has none, or agrees."""
        confirm = getattr(self.inner, "confirm", None)
        if confirm is None:
            return Correction(z, Status.CONVERGED, 0)
        found = self._rounded(confirm(z, row, value), row, value)
        return replace(found, z=z) if found.message == TO_ROUNDING else found

    def _rounded(self, correction: Correction, row: Array, value: float) -> Correction:
        if correction.converged or correction.status is Status.SINGULAR:
            return correction
        z = correction.z
        try:
            residual = np.abs(self.problem.evaluate(z)[0])
        except ArithmeticError:
            return correction
        held = abs(float(row @ z) - value) <= ROUNDED * np.finfo(float).eps * max(1.0, float(np.abs(row) @ np.abs(z)))
        if held and np.all(residual <= ROUNDED * self.problem.rounding(z)):
            return replace(correction, status=Status.CONVERGED, message=TO_ROUNDING)
        return correction
