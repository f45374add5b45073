"""Multipliers that are 1 for every orbit, with the vectors that belong to them.

Time, and each continuous symmetry, moves an orbit along itself: a right eigenvector. The gradient of each conserved
quantity is a left one (Poincare 1892). Where both are known their multipliers are taken out exactly: the others are
those of the monodromy matrix where nothing that is conserved changes, up to what only shifts the orbit.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from casadi_skin.bvp.problem import Array
from casadi_skin.bvp.symmetry import SymmetryClass
from casadi_skin.models.conserved import directions, independent, quantities
from casadi_skin.models.ode import OdeModel

LEAST = 1e-4  # smallest singular value of independent directions of norm 1
ACROSS = 1e-4  # cosine between a direction and a gradient that are at right angles


@dataclass(frozen=True, eq=False)
class Trivial:
    """How many multipliers are 1 for every orbit; directions and gradients at phase zero as rows, (any, n) each."""

    count: int
    right: Array
    left: Array

    def across(self, units: Array) -> Array | None:
        """Basis, as columns, of the complement in coordinates x / units: where gradients vanish, across all directions.

        None where not all trivial multipliers have their vectors, or none but that of time is trivial.
        """
        if self.count < 2 or len(self.right) + len(self.left) != self.count:
            return None
        right, left = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (self.right / units, self.left * units))
        if np.max(np.abs(left @ right.T), initial=0.0) > ACROSS:
            return None
        together = np.vstack([right, left])
        return np.asarray(np.linalg.svd(together)[2][len(together) :].T)


def trivial_at(model: OdeModel, symmetry: SymmetryClass, start: Array, parameters: Array) -> Trivial:
    """The trivial multipliers of an orbit of a model of first order through a state at phase zero.

    None of a forced model, one of an autonomous one, two of orbits that come in families; more where more is conserved.
    """
    n = start.size
    if model.forced:
        return Trivial(0, np.empty((0, n)), np.empty((0, n)))
    found, moved = _vectors(model)
    vectors = np.array([np.array(v).ravel() for v in found.call([0.0, start, parameters])])
    right, left = vectors[:moved], vectors[moved:]
    right, left = right[independent(right, LEAST)], left[independent(left, LEAST)]
    by_reversal = int(symmetry is not SymmetryClass.FULL and model.hamiltonian is None)
    return Trivial(max(len(right), 1) + len(left) + by_reversal, right, left)


@lru_cache(maxsize=16)
def _vectors(model: OdeModel) -> tuple[ca.Function, int]:
    """Function (t, x, p) -> directions of time and of symmetries, then gradients; and the number of directions."""
    moved = [model.full_rhs, *directions(model).values()]
    slopes = [ca.gradient(quantity, model.full_state) for quantity in quantities(model).values()]
    return model.function("trivial", *(ca.densify(e) for e in (*moved, *slopes))), len(moved)
