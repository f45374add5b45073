"""The unknown part of the period: decided by the symmetries that a model declares."""

from __future__ import annotations

from enum import Enum

import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.arguments import short_repr
from casadi_skin.model.methods import QUARTER_PERIOD
from casadi_skin.model.ode import OdeModel

Array = NDArray[np.float64]


class SymmetryClass(Enum):
    """Part of the period that determines the orbit; the value is the fraction of the period."""

    QUARTER = 0.25
    HALF = 0.5
    FULL = 1.0

    @classmethod
    def _missing_(cls, value: object) -> SymmetryClass:
        """Raises ValueError in one line."""
        raise ValueError(f"symmetry class: given {short_repr(value)}; accepted: 0.25, 0.5, 1.0")

    @property
    def reason(self) -> str:
        """Symmetries that justify the class, in words."""
        return {
            SymmetryClass.QUARTER: QUARTER_PERIOD,
            SymmetryClass.HALF: "reversible: half of the period",
            SymmetryClass.FULL: "no reversal declared: the full period, a phase condition and an unfolding parameter",
        }[self]


def symmetry_class(model: OdeModel) -> SymmetryClass:
    """Smallest part of the period that the declared symmetries of `model` allow."""
    if model.reversal is None:
        return SymmetryClass.FULL
    return SymmetryClass.HALF if model.half_period is None else SymmetryClass.QUARTER


def pinned_components(model: OdeModel, symmetry: SymmetryClass) -> tuple[list[int], list[int]]:
    """Components of the full state that vanish at the start and at the end of the part of the period.

    The orbit starts in Fix(R); it ends in Fix(P R) after a quarter and in Fix(R) after half a period (Lamb and
    Roberts 1998). Raises ValueError when the symmetries that the class rests on are not declared.
    """
    if symmetry is SymmetryClass.FULL:
        return [], []
    if model.reversal is None or (symmetry is SymmetryClass.QUARTER and model.half_period is None):
        raise ValueError(
            f"{model.name}: the {symmetry.name.lower()}-period class needs symmetries that are not declared"
        )
    start = np.array(model.reversal)
    end = start * np.array(model.half_period) if symmetry is SymmetryClass.QUARTER else start
    first, last = np.flatnonzero(start < 0).tolist(), np.flatnonzero(end < 0).tolist()
    if len(first) + len(last) != model.full_size:
        raise ValueError(f"{model.name}: the reversal fixes {len(first) + len(last)} of {model.full_size} components")
    return first, last


def unfolded_phases(model: OdeModel, symmetry: SymmetryClass, theta: Array) -> tuple[Array, Array]:
    """Places of phases of the whole period in the part that is solved for, and the signs that the symmetries give.

    Fractions of the part, shape (len(theta),), and signs of the full state, shape (len(theta), full_size).
    """
    turn = np.mod(np.asarray(theta, dtype=float) / (2.0 * np.pi), 1.0)
    signs = np.ones((turn.size, model.full_size))
    half_period = np.array(model.half_period if symmetry is SymmetryClass.QUARTER else 1)
    if symmetry is SymmetryClass.QUARTER:
        later = turn >= 0.5
        turn = np.where(later, turn - 0.5, turn)
        signs[later] *= half_period
    if symmetry is not SymmetryClass.FULL:
        # x(-t) = R x(t); with x(t + T/2) = P x(t) it folds the second quarter onto the first.
        fold = 0.25 if symmetry is SymmetryClass.QUARTER else 0.5
        back = turn > fold
        turn = np.where(back, 2 * fold - turn, turn)
        signs[back] *= np.array(model.reversal) * half_period
    return turn / symmetry.value, signs
