"""Multipliers of periodic orbits of any model, over the full period.

From the linearised collocation equations, whose interval maps are multiplied (Doedel 1981; Fairgrieve and Jepson 1991),
and, sharing nothing with these, from CVODES sensitivities. Multipliers smaller than 1 are the inverses of those of the
inverse maps multiplied the other way round: of a product with entries near 1 they would have no digits. The flow
itself is the eigenvector of the trivial multiplier of an autonomous orbit: the maps across it have the others alone, so
that one of these may be 1 as well, as at a fold, where two equal eigenvalues of the whole matrix have half the digits.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.bvp.problem import Array
from casadi_skin.bvp.stated_problem import BoundaryProblem
from casadi_skin.bvp.symmetry import SymmetryClass
from casadi_skin.integrators.cvodes import CvodesError, CvodesOptions, run_cvodes
from casadi_skin.integrators.trajectory import IntegrationError, Trajectory, size_of
from casadi_skin.models.ode import OdeModel
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.result import FullPeriodFloquet
from casadi_skin.stability.trivial import Trivial, trivial_at

DRIFT = 100.0  # tolerances by which the trivial multiplier may be off, times the size of the balanced monodromy matrix
LOCAL = 1e-3  # of the tolerance, for one step of CVODES
TIGHTEST = 1e-13
MAX_STEPS = 200_000
SMALL = 0.5  # modulus above which no multiplier has lost digits in a product with entries near 1
LARGEST_LOGARITHM = 709.0  # of a double
ROUNDED = 1e3  # roundings of the product below which a multiplier has no digits
CLOSE = 1e-2  # to 1: multipliers that the trivial one disturbs
SLOWEST = 1e-6  # of the fastest motion along an orbit: slower, its direction is not known well


def by_collocation(
    problem: BoundaryProblem, z: Array, model: OdeModel, symmetry: SymmetryClass, trivial: Trivial, tolerance: float
) -> FullPeriodFloquet:
    """Multipliers from the interval maps of the linearised equations.

    The state of the problem may have others beside it: those of the model come first, and do not depend on these.
    """
    n = model.full_size
    jacobians = stage_jacobians(problem, z)[:, :n, :n]
    maps = interval_maps(problem, jacobians)
    if symmetry is not SymmetryClass.FULL:
        maps = _whole(maps, model, symmetry)
    quadrature = np.outer(problem.constants, problem.table.extended[-1]).ravel()
    contraction = float(quadrature @ np.trace(jacobians, axis1=1, axis2=2)) / symmetry.value
    along = velocities(problem, z, n) if trivial.count == 1 else None
    return multipliers_of(maps, trivial, tolerance, contraction, along)


def velocities(problem: BoundaryProblem, z: Array, n: int) -> Array | None:
    """Derivatives of the first n states at the ends of the intervals, one a row; None where they rest."""
    columns = np.arange(problem.resolution + 1) * problem.table.ends.size
    x = z[: problem.states].reshape(problem.columns, -1)[columns]
    mapped = problem.formulation.field_function.map(columns.size)
    field = mapped(problem._fractions()[columns][None], x.T, *problem.repeated(z, columns.size))
    return _moving(np.array(field[0]).T[:, :n], x[:, :n])


def _moving(along: Array, x: Array) -> Array | None:
    """Derivatives along an orbit over its states, where it moves at all of them."""
    speeds = np.linalg.norm(along, axis=1)
    moves = np.min(speeds) > SLOWEST * np.max(speeds) and np.max(speeds) > SLOWEST * np.max(np.abs(x))
    return along if moves else None


def stage_jacobians(problem: BoundaryProblem, z: Array) -> Array:
    """Derivatives of the field, for an interval of unit length, at all stages, shape (intervals * degree, n, n)."""
    n, d, K = problem.formulation.states, problem.degree, problem.resolution
    values = z[: problem.states].reshape(problem.columns, n)
    stage = problem.stages
    starts = np.cumsum(problem.constants) - problem.constants
    places = (starts[:, None] + problem.constants[:, None] * problem.table.nodes).ravel()
    field = problem.formulation.field_function
    arguments = field.sx_in() if field.is_a("SXFunction") else field.mx_in()
    by_states = ca.Function("J", arguments, [ca.densify(field.call(arguments, True, False)[1])])
    blocks = np.array(by_states.map(K * d)(places[None], values[stage].T, *problem.repeated(z, K * d)))
    return np.asarray(blocks.reshape(n, K * d, n).transpose(1, 0, 2))


def interval_maps(problem: BoundaryProblem, jacobians: Array) -> Array:
    """Transition matrices over the intervals, in order of time, shape (intervals, n, n)."""
    n, d, K = jacobians.shape[1], problem.degree, problem.resolution
    extended = problem.table.extended
    h = problem.constants
    maps = np.empty((K, n, n))
    for k in range(K):
        blocks = jacobians[k * d : (k + 1) * d]
        system = np.eye(n * d) - h[k] * np.einsum("ij,jab->iajb", extended[:d], blocks).reshape(n * d, n * d)
        stages = np.linalg.solve(system, np.tile(np.eye(n), (d, 1))).reshape(d, n, n)
        maps[k] = np.eye(n) + h[k] * np.einsum("j,jab,jbc->ac", extended[-1], blocks, stages)
    return maps


def _whole(maps: Array, model: OdeModel, symmetry: SymmetryClass) -> Array:
    """Maps over the full period from those over the part that the symmetry leaves: reversed in time and repeated."""
    reversal = np.diag(np.array(model.reversal, dtype=float))
    half = np.diag(np.array(model.half_period, dtype=float)) if symmetry is SymmetryClass.QUARTER else None
    mirror = reversal if half is None else half @ reversal
    back = np.array([mirror @ np.linalg.inv(m) @ mirror for m in maps[::-1]])
    there = np.concatenate([maps, back])
    if half is None:
        return there
    return np.concatenate([there, np.array([half @ m @ half for m in there])])


def by_cvodes(
    model: OdeModel, start: Array, parameters: Array, period: float, symmetry: SymmetryClass, tolerance: float
) -> FullPeriodFloquet:
    """Multipliers from the sensitivity of the flow over the period to its start; raises IntegrationError."""
    kind = type(model.state)
    s, x, p = kind.sym("s"), kind.sym("x", model.full_size), kind.sym("p", model.parameters.numel())
    dae = {"t": s, "x": x, "p": p, "ode": period * model.field_at(period * s, x, p)}
    local = max(LOCAL * tolerance, TIGHTEST)
    options = CvodesOptions(local, local * size_of(start), MAX_STEPS, stiff=True, sensitivity_errors=True)
    try:
        matrix = np.array(run_cvodes(options.transition("monodromy", dae), start, parameters)["jac_xf_x0"])
    except CvodesError as error:
        empty = Trajectory(np.empty((0, start.size)), 0)
        raise IntegrationError("cvodes", str(error), empty, np.array([period])) from error
    trivial = trivial_at(model, symmetry, start, parameters)
    rate = np.array(model.vector_field(0.0, start, parameters)).T * period
    along = _moving(np.tile(rate, (2, 1)), start[None]) if trivial.count == 1 else None
    return multipliers_of(matrix[None], trivial, tolerance, along=along)


def multipliers_of(
    maps: Array, trivial: Trivial, tolerance: float, contraction: float | None = None, along: Array | None = None
) -> FullPeriodFloquet:
    """Multipliers of the product of maps, later ones times earlier ones; the logarithm of its determinant may be known.

    The trivial ones with the vectors that belong to them are taken out before the others are computed; with velocities
    `along` the orbit that of time is, map by map.
    """
    from scipy.linalg import matrix_balance

    matrix = _product(maps)
    _, (units, _) = matrix_balance(matrix, permute=False, separate=True)  # what is large is not so by its units
    balanced = maps * units / units[:, None]
    allowed = DRIFT * tolerance * max(1.0, float(np.linalg.norm(_product(balanced), 2)))
    count = trivial.count
    values = _eigenvalues(balanced, contraction)
    is_other = _others(values, count)
    near, others = values[~is_other], values[is_other]
    close = np.min(np.abs(others - 1.0), initial=np.inf) < CLOSE
    if along is None or not (close or len(maps) > 1):  # of one map the whole has more digits where 1 stands alone
        basis = trivial.across(np.asarray(units, dtype=float))
        if basis is not None and others.size:
            others = _eigenvalues(balanced, contraction, basis)
    else:
        near, turned = _across(balanced, along / units)
        others = _eigenvalues(turned, contraction)
    deviation = float(np.prod(np.abs(near - 1.0)) ** (1.0 / max(count, 1))) if count else 0.0
    values = np.concatenate([near, others])
    return FullPeriodFloquet(values, matrix, count, deviation, allowed if count < 2 else float(np.sqrt(allowed)))


def _across(maps: Array, along: Array) -> tuple[ComplexArray, Array]:
    """The growth along the flow over the period, shape (1,); and the maps across it, one an interval."""
    frames = np.array([np.linalg.qr(v[:, None], mode="complete")[0] for v in along])
    frames[-1] = frames[0]
    turned = np.einsum("kai,kab,kbj->kij", frames[1:], maps, frames[:-1])
    return np.array([np.prod(turned[:, 0, 0])], dtype=complex), turned[:, 1:, 1:]


def _product(maps: Sequence[Array] | Array) -> Array:
    """Later maps times earlier ones."""
    total = np.eye(maps[0].shape[0])
    for matrix in maps:
        total = matrix @ total
    return total


def _eigenvalues(maps: Array, contraction: float | None, across: Array | None = None) -> ComplexArray:
    """Eigenvalues of the product in descending modulus; those far below 1 from the inverse product.

    With a basis `across`, of the product between its columns.

    Rounding is relative to the norm of either product, so that each serves the eigenvalues on its own side of the
    modulus at which both are equally good. A single one that is tiny, or huge where none is tiny, follows from
    Liouville's formula, their product being exp(contraction): maps of intervals that are long for the fastest
    contraction or expansion have lost its digits.
    """
    if maps.shape[1] == 0:
        return np.empty(0, dtype=complex)
    matrix, basis = _product(maps), np.eye(maps.shape[1]) if across is None else across
    forward = np.linalg.eigvals(basis.T @ matrix @ basis).astype(complex)
    forward = forward[np.argsort(-np.abs(forward))]
    if len(maps) == 1:
        return forward
    inverse = _inverse_product(maps)
    if inverse is None:
        backward, modulus = forward, np.abs(forward)
        even = ROUNDED * float(np.finfo(float).eps * np.linalg.norm(matrix, 2))
    else:
        reciprocal = np.linalg.eigvals(basis.T @ inverse @ basis).astype(complex)
        backward = np.full(reciprocal.size, np.inf, dtype=complex)  # of what rounding made zero
        np.divide(1.0, reciprocal, out=backward, where=reciprocal != 0)
        backward = backward[np.argsort(-np.abs(backward))]
        modulus = np.sqrt(np.abs(forward)) * np.sqrt(np.abs(backward))
        even = float(np.sqrt(np.linalg.norm(matrix, 2)) / np.sqrt(np.linalg.norm(inverse, 2)))
    even = np.inf if matrix.size == 1 else even
    small = (np.abs(forward) < SMALL) & (modulus < even)
    large = np.abs(forward) > 1.0 / SMALL
    if contraction is not None and np.count_nonzero(small) == 1:
        return _by_liouville(maps, forward, forward.size - 1, contraction)
    if contraction is not None and np.count_nonzero(large) == 1 and not small.any():
        return _by_liouville(maps, forward, 0, contraction)
    return np.asarray(np.where(small, backward, forward))


def _by_liouville(maps: Array, values: ComplexArray, index: int, contraction: float) -> ComplexArray:
    """The eigenvalues, one from their product exp(contraction) and the others; as they are where it exceeds doubles."""
    others = np.delete(values, index)
    logarithm = contraction - float(np.sum(np.log(np.abs(others))))
    if logarithm > LARGEST_LOGARITHM:
        return values
    sign = np.sign(np.prod([np.linalg.slogdet(m)[0] for m in maps]) * np.prod(others / np.abs(others)).real)
    result = values.copy()
    result[index] = sign * np.exp(logarithm)
    return result


def _inverse_product(maps: Array) -> Array | None:
    """The inverse of the product, from those of the maps; None where it has no finite entries."""
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            inverse = _product([np.linalg.inv(m) for m in maps[::-1]])
    except np.linalg.LinAlgError:
        return None
    return inverse if np.all(np.isfinite(inverse)) else None


def _others(values: ComplexArray, trivial: int) -> NDArray[np.bool_]:
    """Which of the values are not the `trivial` ones nearest to 1."""
    keep = np.ones(values.size, dtype=bool)
    keep[np.argsort(np.abs(values - 1.0), kind="stable")[:trivial]] = False
    return keep
