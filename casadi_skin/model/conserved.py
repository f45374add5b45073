"""Conserved quantities of a model, and the directions in which the symmetries that belong to them move its state.

In canonical coordinates, x' = J grad H, a conserved quantity I belongs to the symmetry with the direction J grad I
(Noether). J is recognised where it is that of positions and momenta, or of positions and velocities with a mass matrix.
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.arguments import short_repr
from casadi_skin.model.expressions import Expression
from casadi_skin.model.methods import QUARTER_PERIOD
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.result import in_turn

Array = NDArray[np.float64]
HAMILTONIAN = "hamiltonian"
FIELD_TRIALS, SAME_FIELD_RTOL = 3, 1e-9  # random points at which two fields are compared, and their relative difference
RANK_SINGULAR_VALUE = 1e-6  # smallest singular value of directions of norm 1 that are independent


def quantities(model: OdeModel) -> dict[str, Expression]:
    """All conserved quantities by name, the hamiltonian first."""
    first = {} if model.hamiltonian is None else {HAMILTONIAN: model.hamiltonian}
    return first | dict(model.conserved)


def direction(model: OdeModel, name: str) -> Expression | None:
    """The direction of the symmetry that belongs to a conserved quantity other than the hamiltonian.

    Declared, or found from a canonical hamiltonian; None where neither is.
    """
    if name in model.symmetries:
        return model.symmetries[name]
    if model.hamiltonian is None or model.full_size % 2:
        return None
    slope = ca.gradient(model.hamiltonian, model.full_state)
    for structure in _structures(model):
        if _proportional(model, model.full_rhs, structure @ slope):
            return structure @ ca.gradient(model.conserved[name], model.full_state)
    return None


def directions(model: OdeModel) -> dict[str, Expression]:
    """Directions of the symmetries, by the names of the quantities that they conserve."""
    found = {name: direction(model, name) for name in model.conserved}
    return {name: expression for name, expression in found.items() if expression is not None}


def is_odd(model: OdeModel, name: str) -> bool:
    """Whether a conserved quantity changes its sign under the declared reversal."""
    assert model.reversal is not None
    value = model.function("I", ca.densify(quantities(model)[name]))
    signs, generator = np.array(model.reversal), np.random.default_rng(2)
    for _ in range(FIELD_TRIALS):
        x, p = np.abs(generator.normal(size=model.full_size)), np.abs(generator.normal(size=model.parameters.numel()))
        one, other = float(value(0.0, x, p)), float(value(0.0, signs * x, p))
        if not abs(one + other) <= SAME_FIELD_RTOL * (abs(one) + abs(other)):
            return False
    return True


def independent(vectors: Array, least: float = RANK_SINGULAR_VALUE) -> list[int]:
    """Which of several vectors, rows, are independent of those before them."""
    kept: list[int] = []
    for i, vector in enumerate(vectors):
        if not np.linalg.norm(vector) > 0.0:
            continue
        rows = np.array([vectors[k] / np.linalg.norm(vectors[k]) for k in (*kept, i)])
        if np.linalg.svd(rows, compute_uv=False)[-1] > least:
            kept.append(i)
    return kept


def _structures(model: OdeModel) -> Iterator[Expression]:
    """Matrices J of canonical coordinates: halves, pairs, positions and velocities with a mass matrix."""
    n, kind = model.full_size // 2, type(model.state)
    eye, zero = np.eye(n), np.zeros((n, n))
    halves = np.block([[zero, eye], [-eye, zero]])
    yield kind(ca.DM(halves))
    yield kind(ca.DM(np.kron(eye, [[0.0, 1.0], [-1.0, 0.0]])))
    if kind is ca.SX:
        velocity = model.full_state[n:]
        mass = ca.hessian(model.hamiltonian, velocity)[0]
        if not ca.depends_on(mass, model.full_state):
            inverse = ca.inv(ca.densify(mass))
            yield ca.vertcat(ca.horzcat(ca.SX(n, n), inverse), ca.horzcat(-inverse, ca.SX(n, n)))


def _proportional(model: OdeModel, field: Expression, other: Expression) -> bool:
    """Whether two fields differ by a constant factor, at random points."""
    both = model.function("both", ca.densify(field), ca.densify(other))
    generator, factor = np.random.default_rng(1), 0.0
    for trial in range(FIELD_TRIALS):
        x, p = np.abs(generator.normal(size=model.full_size)), np.abs(generator.normal(size=model.parameters.numel()))
        a, b = (np.array(v).ravel() for v in both(0.0, x, p))
        if not (np.all(np.isfinite(a)) and np.all(np.isfinite(b)) and b @ b > 0.0):
            return False
        factor = factor if trial else float(a @ b / (b @ b))
        if not np.max(np.abs(a - factor * b)) <= SAME_FIELD_RTOL * np.max(np.abs(a)):
            return False
    return True


# The unknown part of the period: decided by the symmetries that a model declares --------------------------------------


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


@in_turn
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
