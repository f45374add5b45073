"""Conserved quantities of a model, and the directions in which the symmetries that belong to them move its state.

In canonical coordinates, x' = J grad H, a conserved quantity I belongs to the symmetry with the direction J grad I
(Noether). J is recognised where it is that of positions and momenta, or of positions and velocities with a mass matrix.
"""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.expressions import Expression
from casadi_skin.model.ode import OdeModel

Array = NDArray[np.float64]
HAMILTONIAN = "hamiltonian"
TRIALS, SAME = 3, 1e-9  # random points at which two fields are compared, and their relative difference
RANK = 1e-6  # smallest singular value of directions of norm 1 that are independent


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
    for _ in range(TRIALS):
        x, p = np.abs(generator.normal(size=model.full_size)), np.abs(generator.normal(size=model.parameters.numel()))
        one, other = float(value(0.0, x, p)), float(value(0.0, signs * x, p))
        if not abs(one + other) <= SAME * (abs(one) + abs(other)):
            return False
    return True


def independent(vectors: Array, least: float = RANK) -> list[int]:
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
    for trial in range(TRIALS):
        x, p = np.abs(generator.normal(size=model.full_size)), np.abs(generator.normal(size=model.parameters.numel()))
        a, b = (np.array(v).ravel() for v in both(0.0, x, p))
        if not (np.all(np.isfinite(a)) and np.all(np.isfinite(b)) and b @ b > 0.0):
            return False
        factor = factor if trial else float(a @ b / (b @ b))
        if not np.max(np.abs(a - factor * b)) <= SAME * np.max(np.abs(a)):
            return False
    return True
