"""Multipliers of periodic orbits of any model, over the full period.

From the linearised collocation equations, whose interval maps are multiplied (Doedel 1981; Fairgrieve and Jepson 1991),
and, sharing nothing with these, from CVODES sensitivities. Multipliers smaller than 1 are the inverses of those of the
inverse maps multiplied the other way round: of a product with entries near 1 they would have no digits. The flow
itself is the eigenvector of the trivial multiplier of an autonomous orbit: the maps across it have the others alone, so
that one of these may be 1 as well, as at a fold, where two equal eigenvalues of the whole matrix have half the digits.
Huge and tiny multipliers at once, and those that no double holds, come from a periodic Schur form (`product_spectrum`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from casadi_skin.bvp.problem import Array
from casadi_skin.bvp.stated_problem import BoundaryProblem
from casadi_skin.bvp.symmetry import SymmetryClass
from casadi_skin.integrators.cvodes import CvodesError, CvodesOptions, run_cvodes
from casadi_skin.integrators.trajectory import IntegrationError, Trajectory, size_of
from casadi_skin.models.ode import OdeModel
from casadi_skin.stability.interval_maps import Parts, interval_maps, moving, stage_jacobians, velocities_at
from casadi_skin.stability.product_spectrum import (
    SPREAD,
    Spectrum,
    by_liouville,
    scaled_product,
    spectrum_of,
)
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.result import LARGEST_LOGARITHM, FullPeriodFloquet
from casadi_skin.stability.trivial import Trivial, trivial_at

DRIFT = 100.0  # tolerances by which the trivial multiplier may be off, times the size of the balanced monodromy matrix
LOCAL = 1e-3  # of the tolerance, for one step of CVODES
TIGHTEST = 1e-13
MAX_STEPS = 200_000
CLOSE = 1e-2  # to 1: multipliers that the trivial one disturbs


def by_collocation(
    problem: BoundaryProblem, z: Array, model: OdeModel, symmetry: SymmetryClass, trivial: Trivial, tolerance: float
) -> FullPeriodFloquet:
    """Multipliers from the interval maps of the linearised equations.

    The state of the problem may have others beside it: those of the model come first, and do not depend on these.
    """
    n = model.full_size
    jacobians = stage_jacobians(problem, z)[:, :n, :n]
    maps = interval_maps(problem, jacobians)
    whole = symmetry is SymmetryClass.FULL
    if not whole:
        maps = _whole(maps, model, symmetry)
    quadrature = np.outer(problem.constants, problem.table.extended[-1]).ravel()
    contraction = float(quadrature @ np.trace(jacobians, axis1=1, axis2=2)) / symmetry.value
    along = velocities_at(problem, z, n) if trivial.count == 1 else None
    parts = Parts(problem, z, jacobians) if whole else None
    return multipliers_of(maps, trivial, tolerance, contraction, along, parts)


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
    along = moving(np.tile(rate, (2, 1)), start[None]) if trivial.count == 1 else None
    found = multipliers_of(matrix[None], trivial, tolerance, along=along)
    blurred = int(np.count_nonzero(found.log_moduli < np.log(local)))
    return replace(found, blurred=blurred)


def multipliers_of(
    maps: Array, trivial: Trivial, tolerance: float, contraction: float | None = None, along: Array | None = None,
    parts: Parts | None = None,
) -> FullPeriodFloquet:  # fmt: skip
    """Multipliers of the product of maps, later ones times earlier ones; the logarithm of its determinant may be known.

    The trivial ones with the vectors that belong to them are taken out before the others are computed; with velocities
    `along` the orbit that of time is, map by map. `parts` of the intervals are taken where the maps have lost digits of
    several multipliers that are far from 1.
    """
    from scipy.linalg import matrix_balance

    matrix, size = scaled_product(maps)
    _, (scales, _) = matrix_balance(matrix, permute=False, separate=True)  # no entry is large by its units
    units = np.asarray(scales, dtype=float)
    balanced = maps * units / units[:, None]
    count = trivial.count
    near, others = _parted(balanced, units, trivial, along)
    lost = parts is not None and others.far > 1 and parts.needed
    if lost and parts is not None and (finer := parts.maps()) is not None:
        balanced, lost = finer[0] * units / units[:, None], False
        near, others = _parted(balanced, units, trivial, None if along is None else finer[1])
    if contraction is not None:  # at rest the one nearest to 1, which stands for the trivial one, may be far from it
        others = by_liouville(others, balanced, contraction - (float(np.sum(near.logs)) if along is None else 0.0))
    deviation = float(np.prod(np.abs(near.values - 1.0)) ** (1.0 / max(count, 1))) if count else 0.0
    logs = np.concatenate([near.logs, others.logs])
    allowed = DRIFT * tolerance * _largest(matrix * units / units[:, None], size, others)
    monodromy = matrix * np.exp(min(size, LARGEST_LOGARITHM))
    values = np.concatenate([near.values, others.values])
    allowed = allowed if count < 2 else float(np.sqrt(allowed))
    errors = np.full(others.logs.size, allowed)
    return FullPeriodFloquet(values, monodromy, count, deviation, errors, allowed, logs, lost)


def _parted(balanced: Array, units: Array, trivial: Trivial, along: Array | None) -> tuple[Spectrum, Spectrum]:
    """The trivial multipliers and the others."""
    found = spectrum_of(balanced)
    is_other = _others(found.values, trivial.count)
    near, others = found.taken(~is_other), found.taken(is_other)
    close = np.min(np.abs(others.values - 1.0), initial=np.inf) < CLOSE
    if along is not None and (close or len(balanced) > 1):  # of one map the whole has more digits where 1 stands alone
        growth, turned = _across(balanced, along / units)
        return Spectrum.of(growth), spectrum_of(turned)
    basis = None if along is not None or found.extreme else trivial.across(units)
    return (near, spectrum_of(balanced, basis)) if basis is not None and others.logs.size else (near, others)


def _largest(product: Array, size: float, others: Spectrum) -> float:
    """The size that errors of multipliers near 1 are relative to: no less than 1."""
    if others.extreme:
        return float(np.exp(np.max(others.logs[np.abs(others.logs) <= SPREAD], initial=0.0)))
    return max(1.0, float(np.linalg.norm(product, 2) * np.exp(min(size, LARGEST_LOGARITHM))))


def _across(maps: Array, along: Array) -> tuple[ComplexArray, Array]:
    """The growth along the flow over the period, shape (1,); and the maps across it, one an interval."""
    frames = np.array([np.linalg.qr(v[:, None], mode="complete")[0] for v in along])
    frames[-1] = frames[0]
    turned = np.einsum("kai,kab,kbj->kij", frames[1:], maps, frames[:-1])
    return np.array([np.prod(turned[:, 0, 0])], dtype=complex), turned[:, 1:, 1:]


def _others(values: ComplexArray, trivial: int) -> NDArray[np.bool_]:
    """Which of the values are not the `trivial` ones nearest to 1."""
    keep = np.ones(values.size, dtype=bool)
    keep[np.argsort(np.abs(values - 1.0), kind="stable")[:trivial]] = False
    return keep
