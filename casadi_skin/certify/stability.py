"""`certify_stability`: a proof that an orbit is stable, or that it is not, from its linearised equations in balls."""

from __future__ import annotations

import numpy as np

from casadi_skin.certify import balls
from casadi_skin.certify.certificate import STABLE, UNDECIDED, UNSTABLE, ProvedStability
from casadi_skin.certify.certify import HARMONIC_WEIGHT, best_attempt, reason_of
from casadi_skin.certify.exponents import Linearised, enclosed_exponent, linearised, negative_eigenvalues
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.orbit import Orbit
from casadi_skin.solve.watch import one_thread
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.tongues.diagram import StabilityEdge
from casadi_skin.zero.problem import Array

NEAREST_TO_CHANGE = 1e-8  # relative distance from a change at which proofs are tried first
DISTANCE_GROWTH = 10.0
TWO_PI = 2.0 * np.pi
EXPONENTS_TRIED = 3  # exponents farthest from the axis


def certify_stability(orbit: Orbit) -> ProvedStability:
    """Prove that an orbit is stable, or that it is unstable, to small disturbances of any symmetry.

    Arguments:
        orbit: an orbit that `certify` accepts.

    Returns:
        The verdict with what proves it; "not decided" where exponents are too near to each other or to those of q',
        as at the edges of tongues, or where the orbit itself is not proved.

    Raises:
        ValueError: the model has no such forces or the orbit no such symmetry, in one line.
        ImportError: python-flint (the extra "certify") is missing.
    """
    flint = balls.flint()
    with flint.ctx.workprec(balls.BALL_PRECISION_BITS), one_thread():
        family, attempt = best_attempt(orbit)
        if not attempt.proved:
            return _undecided(orbit, f"the orbit is not proved: {reason_of(attempt)}")
        if attempt.series.system.tail is not None:
            return _undecided(orbit, "the multipliers of a chain with a tail that is no unknown are not enclosed")
        problem = linearised(attempt.series, flint.arb(HARMONIC_WEIGHT), attempt.radius, attempt.constants.reach)
        floquet = orbit.floquet()
        if family.coordinates.mode.size != floquet.mu.size + 1:
            return _undecided(orbit, "its multipliers were not computed from the whole lattice's reversal")
        if floquet.stable:
            angles = np.arccos(np.clip(1.0 + 2.0 * floquet.mu.real, -1.0, 1.0))
            return _stable(orbit, problem, np.sort(angles) * problem.step / TWO_PI)
        return _unstable(orbit, problem, floquet.mu)


def certify_change(branch: Branch, change: StabilityEdge) -> tuple[float, float] | None:
    """Prove that a family changes its stability between two values of S, as near to a change as proofs separate them.

    Arguments:
        branch: a family of a model that `certify` accepts.
        change: one of `branch.changes`.

    Returns:
        S on either side, in ascending order, proved stable at one and unstable at the other; None where no pair out to
        a quarter of the tongue's width is. That both lie on one curve of orbits is what `certify_branch` proves.

    Raises:
        ValueError, ImportError: as `certify`.
    """
    distance = max(NEAREST_TO_CHANGE * change.S, 2.0 * change.error)
    while distance <= max(0.25 * change.width, 2.0 * NEAREST_TO_CHANGE * change.S):
        ends = change.S - distance, change.S + distance
        verdicts = {branch.at(S=S).proved_stability.verdict for S in ends}
        if verdicts == {STABLE, UNSTABLE}:
            return ends
        distance *= DISTANCE_GROWTH
    return None


def _undecided(orbit: Orbit, reason: str) -> ProvedStability:
    nothing = complex(np.nan, np.nan)
    return ProvedStability(UNDECIDED, np.zeros((0, 2)), np.zeros(0, np.int64), nothing, np.nan, orbit.S, reason)


def _stable(orbit: Orbit, problem: Linearised, sigma: Array) -> ProvedStability:
    """Numbers of negative eigenvalues between exponents: as many changes as there are pairs leave none elsewhere."""
    if not problem.symmetric:
        return _undecided(orbit, "the equations are reversible only: no signatures hold multipliers on the circle")
    ends = np.concatenate([[0.0], sigma, [0.5 * problem.step]])
    between = 0.5 * (ends[:-1] + ends[1:])
    counts = []
    for place, low, high in zip(between.tolist(), ends[:-1].tolist(), ends[1:].tolist(), strict=True):
        count = negative_eigenvalues(problem, place)
        if count is None:
            return _undecided(orbit, f"exponents at sigma = {low:.9g} and {high:.9g} are too near to be separated")
        counts.append(count)
    changes = np.diff(counts)
    if not np.all(changes % 2):
        low, high = between[np.flatnonzero(changes % 2 == 0)[0] :][:2].tolist()
        return _undecided(orbit, f"no exponent is proved between sigma = {low:.9g} and {high:.9g}")
    brackets = np.stack([between[:-1], between[1:]], axis=1)
    nothing = complex(np.nan, np.nan)
    signatures = -np.sign(changes).astype(np.int64)
    return ProvedStability(STABLE, brackets, signatures, nothing, np.nan, orbit.S, "", problem.step)


def _unstable(orbit: Orbit, problem: Linearised, mu: ComplexArray) -> ProvedStability:
    """An enclosure off the real axis of one of the exponents that are farthest from it."""
    root = np.sqrt(mu) + np.sqrt(1.0 + mu)  # sigma of exp(i sigma theta) over theta = 2 pi/step, one of each pair
    sigma = np.log(np.where(np.abs(root) < 1.0, 1.0 / root, root) ** 2) * problem.step / (1j * TWO_PI)
    order = np.argsort(-np.abs(sigma.imag))[:EXPONENTS_TRIED]
    for start in sigma[order].tolist():
        found = enclosed_exponent(problem, start)
        if found is not None and abs(found[0].imag) > found[1]:
            none = np.zeros((0, 2)), np.zeros(0, np.int64)
            return ProvedStability(UNSTABLE, *none, *found, orbit.S, "", problem.step)
    farthest = complex(sigma[order[0]])
    return _undecided(orbit, f"no enclosure of the exponent near sigma = {farthest:.6g} is off the real axis")
